//! Random inputs for every reader of files; all of it is in `tests/`. `fuzz/README.md` says how to run it.
