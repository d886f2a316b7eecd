//! Results, on stdout.

use std::io::Write as _;

/// Prints the one JSON document of a command.
pub fn print_json(document: &serde_json::Value) {
    print_line(&format!("{document:#}"));
}

/// Prints a line of a result.
pub fn print_line(line: &str) {
    // A reader that has gone (`| head`) is no reason to fail.
    let _ = writeln!(std::io::stdout(), "{line}");
}
