//! Models of the human eye, on maps.
