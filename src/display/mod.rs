//! Frame buffers and the CPU twin of every GPU pass.
