//! What the commands of foveal share: values on a command line, progress, tables, plots, pages.

pub mod arguments;
pub mod bars;
pub mod hashes;
pub mod known;
pub mod light;
pub mod machine;
pub mod mode;
pub mod plots;
pub mod print;
pub mod progress;
pub mod report;
pub mod table;
