//! What README and book tell people to type: each command is one that the program takes, and the tutorial does what it says.

use std::fs;
use std::path::PathBuf;

use crate::support::{Foveal, folder, root};

/// README and the chapters of the book.
fn texts() -> Vec<(PathBuf, String)> {
    let book = fs::read_dir(root().join("docs/src")).expect("the book").flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = book.filter(|path| path.extension().is_some_and(|e| e == "md")).collect();
    files.extend([
        root().join("README.md"),
        root().join("scenes/README.md"),
        root().join("traces/README.md"),
    ]);
    files.sort();
    files.into_iter().map(|file| (file.clone(), fs::read_to_string(file).expect("a text"))).collect()
}

/// Words as a shell parts them, without what follows a `#`.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in line.chars() {
        match (quote, c) {
            (Some(q), c) if c == q => quote = None,
            (Some(_), c) => word.get_or_insert_default().push(c),
            (None, '\'' | '"') => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => break,
            (None, c) if c.is_whitespace() => words.extend(word.take()),
            (None, c) => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

/// Commands of the program in a text: lines of code that begin with its name, or with how cargo runs it.
fn commands(text: &str) -> Vec<String> {
    let text = text.replace("\\\n", " ");
    let of_line = |line: &str| {
        let code = line.strip_prefix("    ").or_else(|| line.strip_prefix("$ "))?.trim_start();
        let ways = ["foveal ", "target/release/foveal ", "cargo run --release -- "];
        ways.iter().find_map(|way| code.strip_prefix(way)).map(str::to_owned)
    };
    text.lines().filter_map(of_line).collect()
}

#[test]
fn every_command_that_people_read_is_taken() {
    let mut count = 0;
    for (file, text) in texts() {
        for line in commands(&text) {
            // What follows a pipe is another program.
            let line = line.split(" | ").next().unwrap_or_default().split(" && ").next().unwrap_or_default();
            if line.contains('…') || line.contains("...") || line.contains('$') {
                continue;
            }
            count += 1;
            // Help is what comes of it where all before makes sense.
            let mut command = Foveal::new("");
            for word in words(line) {
                command = command.arg(word);
            }
            let ended = command.arg("--help").run();
            assert_eq!(ended.code, Some(0), "{}: foveal {line}\n{}", file.display(), ended.err);
        }
    }
    assert!(count > 50, "{count} commands were found");
}

/// A line without what differs from run to run: numbers, and where files are.
fn shape(line: &str) -> String {
    let mut shape = String::new();
    for word in line.split_whitespace() {
        let is_path = word.starts_with('/');
        let mut in_number = false;
        for c in if is_path { "PATH" } else { word }.chars() {
            let is_number = c.is_ascii_digit() || in_number && matches!(c, '.' | 'e');
            if !(is_number && in_number) {
                shape.push(if is_number { '0' } else { c });
            }
            in_number = is_number;
        }
        shape.push(' ');
    }
    shape.trim_end().to_owned()
}

#[test]
fn shapes_have_no_numbers_and_no_places() {
    assert_eq!(shape("10 frames of A,  median 99.5 ms"), shape("9 frames of A, median 101 ms"));
    assert_eq!(shape("A: /tmp/x/1.fvbake"), shape("A: /cache/0123.fvbake"));
    assert_ne!(shape("10 frames"), shape("10 frame"));
}

/// Followed literally in an empty folder: files are written as they stand there, commands run in their order, and what they
/// print has the shape that is shown.
#[test]
fn the_tutorial_does_what_it_says() {
    let (folder, cache) = (folder("tutorial"), folder("tutorial-cache"));
    let text = fs::read_to_string(root().join("docs/src/tutorial.md")).expect("the tutorial");
    let mut ran = 0;
    for block in text.split("\n```").skip(1).step_by(2) {
        let (info, body) = block.split_once('\n').unwrap_or((block, ""));
        match info.split_once(' ') {
            Some((_, file)) => fs::write(folder.join(file), format!("{body}\n")).expect("a file"),
            None => {
                assert_eq!(info, "console");
                for step in body.split("$ foveal ").skip(1) {
                    let mut lines = step.lines();
                    let line = lines.next().unwrap_or_default();
                    let mut command = Foveal::new("").inside(&folder);
                    for word in words(line) {
                        command = command.arg(word);
                    }
                    let ended = command.env("FOVEAL_CACHE", &cache).ok();
                    let mut printed = ended.out.lines().map(shape);
                    for shown in lines {
                        let wanted = shape(shown);
                        assert!(
                            printed.by_ref().any(|line| line == wanted),
                            "foveal {line} does not print\n{wanted}\nbut\n{}",
                            ended.out
                        );
                    }
                    ran += 1;
                }
            }
        }
    }
    assert!(ran >= 9, "{ran} commands");
    assert!(folder.join("out/report.html").exists() && folder.join("room.fvl").exists());
}
