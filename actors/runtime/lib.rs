//! A lock-free actor runtime that records and replays.
