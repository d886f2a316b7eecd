//! The √5 lattice and low-discrepancy points.
