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

/// A command line without how the program is called; nothing where another one is.
fn of_foveal(code: &str) -> Option<&str> {
    let code = code.strip_prefix("$ ").unwrap_or(code);
    let ways = ["foveal ", "target/release/foveal ", "cargo run --release -- "];
    // What follows a pipe is another program.
    let line = ways.iter().find_map(|way| code.strip_prefix(way))?;
    Some(line.split(" | ").next().unwrap_or_default().split(" && ").next().unwrap_or_default())
}

/// Commands of the program in a text, each with the lines that stand beneath it: indented, or in a block of ```.
fn commands(text: &str) -> Vec<(String, Vec<String>)> {
    let text = text.replace("\\\n", " ");
    let mut commands: Vec<(String, Vec<String>)> = Vec::new();
    let (mut in_block, mut follows) = (false, false);
    for line in text.lines() {
        if line.starts_with("```") {
            (in_block, follows) = (!in_block, false);
            continue;
        }
        let code = if in_block { Some(line) } else { line.strip_prefix("    ") };
        match (code, code.and_then(of_foveal)) {
            (_, Some(command)) => {
                // Only after a prompt is what follows known to be printed.
                follows = code.is_some_and(|code| code.starts_with("$ "));
                commands.push((command.to_owned(), Vec::new()));
            }
            (Some(printed), None) if follows => {
                commands.last_mut().expect("a command").1.push(printed.to_owned());
            }
            _ => follows = false,
        }
    }
    commands
}

/// Commands in the midst of a sentence, but for those that name a kind of thing: `SCENE`, `…`.
fn mentioned(text: &str) -> Vec<String> {
    let is_placeholder = |word: &str| {
        word.contains('…') || word.starts_with('@') || word.len() > 1 && !word.chars().any(char::is_lowercase)
    };
    let spans = text.split('`').skip(1).step_by(2).filter_map(of_foveal);
    let spans = spans.filter(|line| !line.contains('\n') && !line.split_whitespace().any(is_placeholder));
    spans.map(str::to_owned).collect()
}

/// The command of a line of a text.
fn command_of(line: &str) -> Foveal {
    words(line).into_iter().fold(Foveal::new(""), Foveal::arg)
}

#[test]
fn every_command_that_people_read_is_taken() {
    let mut count = 0;
    for (file, text) in texts() {
        let of_blocks = commands(&text).into_iter().map(|(line, _)| line);
        for line in of_blocks.chain(mentioned(&text)) {
            if line.contains('…') || line.contains("...") || line.contains('$') {
                continue;
            }
            count += 1;
            // Help is what comes of it where all before makes sense.
            let ended = command_of(&line).arg("--help").run();
            assert_eq!(ended.code, Some(0), "{}: foveal {line}\n{}", file.display(), ended.err);
        }
    }
    assert!(count > 100, "{count} commands were found");
}

/// A folder in which the README and the chapter on recordings can be followed: scenes, and recordings of the names used there.
fn with_recordings(name: &str) -> PathBuf {
    let folder = folder(name);
    for part in ["scenes", "traces"] {
        std::os::unix::fs::symlink(root().join(part), folder.join(part)).expect("a link");
    }
    std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_foveal"), folder.join("foveal-of-before"))
        .expect("a link");
    let walk = "walk scenes/gallery/gallery.toml --size 320x240";
    for (how, file) in [("--fps 100 --frames 12", "g.fvl"), ("--fps 10 --frames 16", "walk.fvl")] {
        Foveal::new(&format!("{walk} {how} --record {file}")).inside(&folder).ok();
    }
    folder
}

/// What reads recordings is run as it stands there. Where the text shows what is printed, lines that begin so are printed, in that
/// order; what follows their first word differs from machine to machine.
#[test]
fn what_is_told_of_recordings_is_so() {
    let folder = with_recordings("book");
    let (mut ran, mut compared) = (0, 0);
    for file in ["README.md", "traces/README.md", "docs/src/replay.md"] {
        let text = fs::read_to_string(root().join(file)).expect("a text");
        for (line, shown) in commands(&text) {
            let of_recordings = ["replay ", "log "].iter().any(|command| line.starts_with(command))
                || file == "README.md" && line.contains("--record");
            // Windows stay open, and rerun's files are another program's.
            if !of_recordings || ["--view", "--serve", "rerun", "…"].iter().any(|no| line.contains(no)) {
                continue;
            }
            // What follows `--step` is read.
            let (reads, shown) =
                if line.contains("--step") { (shown.join("\n"), Vec::new()) } else { (String::new(), shown) };
            let ended = command_of(&line).inside(&folder).input(&reads).run();
            let printed = format!("{}{}", ended.out, ended.err);
            let may_end = ended.code == Some(0) || printed.contains("never comes about");
            assert!(may_end, "{file}: foveal {line}: {:?}\n{printed}", ended.code);
            let first = |line: &str| line.split_whitespace().next().map(shape).unwrap_or_default();
            let mut begun = printed.lines().map(first);
            for wanted in shown.iter().filter(|line| !line.contains('…')) {
                let wanted = first(wanted);
                assert!(
                    begun.by_ref().any(|word| word == wanted),
                    "{file}: foveal {line} prints no line of `{wanted}` there but\n{printed}"
                );
                compared += 1;
            }
            ran += 1;
        }
    }
    assert!(ran >= 20 && compared >= 30, "{ran} commands, {compared} lines");
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
