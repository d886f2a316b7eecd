//! Rules of the source tree that no compiler keeps.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use crate::support::{Foveal, root};

/// Sources by their path from the root, with `/`.
fn sources(extension: &str) -> BTreeMap<String, String> {
    fn visit(folder: &Path, name: &str, extension: &str, found: &mut BTreeMap<String, String>) {
        for entry in fs::read_dir(folder).expect("a folder").flatten() {
            let path = entry.path();
            let name = format!("{name}/{}", entry.file_name().to_string_lossy());
            if path.is_dir() {
                visit(&path, &name, extension, found);
            } else if path.extension().is_some_and(|e| e == extension) {
                found.insert(name, fs::read_to_string(&path).expect("a text"));
            }
        }
    }
    let mut found = BTreeMap::new();
    for top in ["src", "actors", "tests", "scenes"] {
        visit(&root().join(top), top, extension, &mut found);
    }
    assert!(!found.is_empty());
    found
}

/// A source without its comments.
fn code(source: &str) -> String {
    source
        .lines()
        .map(|l| l.split("//").next().unwrap_or_default())
        .fold(String::new(), |all, l| all + l + "\n")
}

/// Code without the tests at its end.
fn code_without_tests(source: &str) -> String {
    let code = code(source);
    let tests = ["", "pub(super) "].map(|seen| code.find(&format!("#[cfg(test)]\n{seen}mod tests {{")));
    let end = tests.into_iter().flatten().min().unwrap_or(code.len());
    code[..end].to_owned()
}

/// Whether a file holds nothing but tests and what they need.
fn is_for_tests(path: &str) -> bool {
    let stem = path.rsplit('/').next().unwrap_or(path).trim_end_matches(".rs");
    stem.ends_with("tests")
        || stem.starts_with("test_")
        || path.contains("/tests/")
        || path.starts_with("tests/")
}

/// Whether `word` stands in `text` as a word of its own.
fn has_word(text: &str, word: &str) -> bool {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word).any(|(at, _)| {
        !text[..at].chars().next_back().is_some_and(part)
            && !text[at + word.len()..].chars().next().is_some_and(part)
    })
}

/// Fails if code of `src/` or `actors/` names one of `words` elsewhere than in `places` (beginnings of paths).
fn only_in(words: &[&str], places: &[&str]) {
    for (path, source) in sources("rs") {
        if path.starts_with("src/") || path.starts_with("actors/") {
            let code = code(&source);
            for word in words {
                let allowed = places.iter().any(|p| path.starts_with(p));
                assert!(allowed || !has_word(&code, word), "{path} names {word}; only {places:?} may");
            }
        }
    }
}

#[test]
fn words_are_found() {
    assert!(has_word("a Mutex<u8>", "Mutex") && !has_word("MutexLike, a_Mutex", "Mutex"));
    assert_eq!(code("a // Mutex\nb"), "a \nb\n");
    assert!(
        is_for_tests("src/a/b_tests.rs") && is_for_tests("src/a/tests.rs") && !is_for_tests("src/a/b.rs")
    );
}

/// One owner and messages instead. The loom model of the job pool stands a lock in for a queue of another crate,
/// and a benchmark measures what we do without.
#[test]
fn no_locks() {
    only_in(&["Mutex", "RwLock", "Condvar"], &["actors/runtime/model.rs", "actors/bench/messages/peers.rs"]);
}

#[test]
fn crates_are_named_where_they_belong() {
    only_in(&["obvhs"], &["src/geometry/bvh"]);
    only_in(&["tobj"], &["actors/files/load/"]);
    only_in(&["wgpu", "winit", "egui", "softbuffer"], &["actors/window/"]);
    only_in(&["clap", "plotters"], &["actors/terminal/", "actors/bench/", "actors/program/"]);
    only_in(&["indicatif"], &["actors/terminal/"]);
    only_in(&["axum", "hyper", "jpeg_encoder", "image_webp"], &["actors/serve/"]);
    only_in(&["crossbeam_deque"], &["actors/runtime/"]);
}

/// Results and messages come from the command line; the core and the actors return them.
#[test]
fn only_the_command_line_prints() {
    let may = [
        "actors/terminal/",
        "actors/program/",
        "actors/engine/examples/",
        "actors/runtime/examples/",
        "actors/runtime/build.rs",
    ];
    for (path, source) in sources("rs") {
        let is_program = path.starts_with("src/") || path.starts_with("actors/");
        if is_program && !is_for_tests(&path) && !may.iter().any(|p| path.starts_with(p)) {
            let code = code_without_tests(&source);
            for word in ["println", "eprintln", "print", "eprint"] {
                assert!(!has_word(&code, word) || !code.contains(&format!("{word}!")), "{path} prints");
            }
        }
    }
}

/// The core's modules, each of which may use the ones before it.
const CORE: [&str; 15] = [
    "rng",
    "math",
    "image",
    "scene",
    "geometry",
    "transport",
    "illumination",
    "radiosity",
    "world",
    "display",
    "perception",
    "sampling",
    "splatting",
    "allocation",
    "metrics",
];

/// Uses against the core's order, each with its reason.
const BACKWARD: [(&str, &str); 2] = [
    // The interface by which the tracer is given its diffuse illumination.
    ("src/transport/", "illumination::Irradiance"),
    ("src/transport/", "illumination::Unnamed"),
];

/// Paths below `crate::` that a source names, lists unfolded one level.
fn crate_paths(code: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (at, prefix) in code.match_indices("crate::") {
        let rest = &code[at + prefix.len()..];
        if let Some(list) = rest.strip_prefix('{') {
            let list = &list[..list.find("};").unwrap_or(list.len())];
            let (mut depth, mut item) = (0, String::new());
            for c in list.chars().chain([',']) {
                match c {
                    '{' => depth += 1,
                    '}' => depth -= 1,
                    ',' if depth == 0 => found.push(std::mem::take(&mut item)),
                    c if !c.is_whitespace() => item.push(c),
                    _ => {}
                }
            }
        } else {
            let path = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
            found.push(rest.split(|c| !path(c)).next().unwrap_or_default().to_owned());
        }
    }
    found.retain(|p| !p.is_empty());
    found
}

#[test]
fn imports_of_the_core_point_one_way() {
    assert_eq!(
        crate_paths("use crate::a::B; use crate::{c, d::{E, F}};"),
        ["a::B", "c", "d::EF"].map(|p| p.replace("EF", "E,F"))
    );
    imports_point_one_way("src/", &CORE, &BACKWARD);
}

/// The runtime's folders, each of which may use the ones before it.
const RUNTIME: [&str; 11] = [
    "sync",
    "message",
    "scheduler",
    "mailbox",
    "log",
    "journal",
    "actor",
    "pool",
    "runtime",
    "replay",
    "simulate",
];

#[test]
fn imports_of_the_runtime_point_one_way() {
    imports_point_one_way("actors/runtime/", &RUNTIME, &[]);
}

/// Fails where a module of the package whose sources begin with `package` uses one that comes later in `order`, except
/// as `backward` allows.
fn imports_point_one_way(package: &str, order: &[&str], backward: &[(&str, &str)]) {
    let rank = |module: &str| order.iter().position(|m| *m == module);
    let mut seen = BTreeSet::new();
    for (path, source) in sources("rs") {
        let Some(own) = path.strip_prefix(package) else { continue };
        let own = own.split('/').next().unwrap_or_default().trim_end_matches(".rs");
        // Beside the library: what is built, derived, shown and modelled with it.
        let is_beside = ["lib", "build", "derive", "examples", "model"].contains(&own);
        if is_beside || is_for_tests(&path) {
            continue;
        }
        let own_rank =
            rank(own).unwrap_or_else(|| panic!("{path}: where does {own} stand in {package}'s order?"));
        seen.insert(own_rank);
        for used in crate_paths(&code_without_tests(&source)) {
            let module = used.split("::").next().unwrap_or_default();
            let Some(used_rank) = rank(module) else { panic!("{path} names crate::{used}") };
            let allowed = backward.iter().any(|(from, to)| path.starts_with(from) && used.starts_with(to));
            assert!(used_rank <= own_rank || allowed, "{path} uses {used}, which comes later");
        }
    }
    assert_eq!(seen.len(), order.len(), "{package} has not all of {order:?}");
}

/// Perception works on maps.
#[test]
fn perception_knows_no_scene() {
    for (path, source) in sources("rs") {
        if path.starts_with("src/perception") && !is_for_tests(&path) {
            for used in crate_paths(&code_without_tests(&source)) {
                let module = used.split("::").next().unwrap_or_default();
                assert!(["perception", "image", "math", "rng"].contains(&module), "{path} uses {used}");
            }
        }
    }
}

/// The core is given what it works on: it opens, looks for and writes no file, asks no clock and reads no variable of its
/// process.
#[test]
fn the_core_is_pure() {
    for (path, source) in sources("rs") {
        if path.starts_with("src/") && !is_for_tests(&path) {
            let code = code_without_tests(&source);
            for impure in [
                "std::fs",
                "std::net",
                "std::env::",
                "std::process",
                "std::thread",
                "std::path",
                "Instant",
                "SystemTime",
            ] {
                assert!(!code.contains(impure), "{path} names {impure}");
            }
        }
    }
}

/// The compiler keeps the rest: what a package does not depend on, it cannot name.
#[test]
fn packages_depend_one_way() {
    for (manifest, must_not) in [
        (
            "Cargo.toml",
            &[
                "foveal-files",
                "foveal-runtime",
                "foveal-actors",
                "atomic-write-file",
                "crossbeam",
                "image",
                "wgpu",
                "winit",
                "clap",
            ][..],
        ),
        ("actors/files/Cargo.toml", &["foveal-runtime", "foveal-actors", "foveal-engine", "wgpu", "clap"]),
        ("actors/runtime/Cargo.toml", &["foveal-core", "foveal-actors", "wgpu", "image", "glam"]),
        ("actors/Cargo.toml", &["foveal-engine", "wgpu", "egui", "clap", "image"]),
        (
            "actors/engine/Cargo.toml",
            &[
                "foveal-window",
                "foveal-serve",
                "foveal-terminal",
                "wgpu",
                "egui",
                "winit",
                "clap",
                "axum",
                "tokio",
            ],
        ),
        (
            "actors/serve/Cargo.toml",
            &[
                "foveal-window",
                "foveal-terminal",
                "foveal-bench",
                "wgpu",
                "egui",
                "winit",
                "clap",
                "indicatif",
            ],
        ),
        (
            "actors/window/Cargo.toml",
            &["foveal-serve", "foveal-terminal", "foveal-bench", "clap", "indicatif"],
        ),
        ("actors/terminal/Cargo.toml", &["foveal-bench", "foveal-window", "wgpu"]),
    ] {
        let text = fs::read_to_string(root().join(manifest)).expect("a manifest");
        let after = text.split("[dependencies]").nth(1).expect("dependencies");
        let dependencies = after.split("\n[").next().unwrap_or_default();
        for line in dependencies.lines() {
            let name = line.split(['=', '.', ' ']).next().unwrap_or_default();
            let wrong =
                must_not.iter().any(|m| name == *m || *m == "crossbeam" && name.starts_with("crossbeam"));
            assert!(!wrong, "{manifest} depends on {name}");
        }
    }
}

/// Actors share messages, never each other's types.
#[test]
fn actors_do_not_know_each_other() {
    let actors = ["allocator", "analyzer", "cache_ager", "illuminator", "renderer", "station", "tracer"];
    for (path, source) in sources("rs") {
        let Some(own) = path.strip_prefix("actors/") else { continue };
        let own = own.split('/').next().unwrap_or_default().trim_end_matches(".rs");
        if actors.contains(&own) && !is_for_tests(&path) {
            for used in crate_paths(&code_without_tests(&source)) {
                let module = used.split("::").next().unwrap_or_default();
                assert!(module == own || !actors.contains(&module), "{path} uses {used}");
            }
        }
    }
}

/// What lies outside of the checkout is for tests that say when they skip, not for the program.
#[test]
fn nothing_outside_the_checkout_is_needed() {
    for extension in ["rs", "wgsl", "toml"] {
        for (path, source) in sources(extension) {
            let outside = code_without_tests(&source).contains("../shared");
            assert!(!outside || is_for_tests(&path), "{path} names ../shared");
        }
    }
}

/// Modules that `path` declares, as paths of files that may hold them.
fn declared(path: &str, source: &str) -> Vec<String> {
    let (folder, file) = path.rsplit_once('/').expect("a folder");
    let stem = file.trim_end_matches(".rs");
    let is_root = ["main", "lib", "mod", "generate", "build"].contains(&stem) || folder.ends_with("examples");
    let below = if is_root { folder.to_owned() } else { format!("{folder}/{stem}") };
    let mut found = Vec::new();
    let mut given: Option<String> = None;
    for line in code(source).lines().map(str::trim) {
        if let Some(rest) = line.strip_prefix("#[path = \"") {
            given = rest.split('"').next().map(str::to_owned);
        } else if let Some(name) = line.strip_suffix(';').and_then(|l| l.rsplit_once("mod ")).map(|(_, n)| n)
        {
            match given.take() {
                // All of these lead up to the root.
                Some(up) if up.starts_with("../") => found.push(up.trim_start_matches("../").to_owned()),
                Some(path) => found.push(format!("{folder}/{path}")),
                None => found.extend([format!("{below}/{name}.rs"), format!("{below}/{name}/mod.rs")]),
            }
        }
    }
    found
}

#[test]
fn every_source_is_used() {
    let all = sources("rs");
    let is_root = |path: &str| {
        let of_package =
            path.ends_with("/lib.rs") && root().join(path).with_file_name("Cargo.toml").is_file();
        of_package
            || ["src/lib.rs", "actors/program/main.rs"].contains(&path)
            || path.ends_with("/build.rs")
            || [
                "tests/main.rs",
                "actors/runtime/tests/main.rs",
                "scenes/generate.rs",
                "scenes/generate/lib.rs",
            ]
            .contains(&path)
            || path.contains("/examples/")
    };
    let mut waiting: Vec<String> = all.keys().filter(|p| is_root(p)).cloned().collect();
    let mut used = BTreeSet::new();
    while let Some(path) = waiting.pop() {
        if let Some(source) = all.get(&path)
            && used.insert(path.clone())
        {
            waiting.extend(declared(&path, source));
        }
    }
    for path in all.keys() {
        assert!(used.contains(path), "{path} is part of no crate");
    }
    let text: String = all.values().cloned().collect();
    for path in sources("wgsl").keys() {
        let name = path.rsplit('/').next().unwrap_or(path);
        assert!(text.contains(&format!("!(\"{name}\")")), "{path} is used nowhere");
    }
}

/// Links of our texts lead to files; those of the book to files of the book, since nothing else goes with it.
#[test]
fn links_lead_somewhere() {
    let mut texts = vec![
        "README.md".to_owned(),
        "ARCHITECTURE.md".into(),
        "CHANGELOG.md".into(),
        "CONTRIBUTING.md".into(),
        "actors/engine/README.md".into(),
        "actors/runtime/README.md".into(),
        "actors/program/README.md".into(),
        "actors/python/README.md".into(),
        "docs/src/benchmarks/README.md".into(),
        "fuzz/README.md".into(),
        "scenes/README.md".into(),
        "src/README.md".into(),
        "traces/README.md".into(),
    ];
    let book = fs::read_dir(root().join("docs/src")).expect("the book").flatten();
    let pages = book.map(|e| e.file_name().to_string_lossy().into_owned()).filter(|n| n.ends_with(".md"));
    texts.extend(pages.map(|n| format!("docs/src/{n}")));
    let mut links = 0;
    for text in &texts {
        let content = fs::read_to_string(root().join(text)).expect("a text");
        let targets = content.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for target in targets.filter(|t| !t.starts_with("http")) {
            let folder = Path::new(text).parent().unwrap_or(Path::new(""));
            assert!(root().join(folder).join(target).is_file(), "{text} links to {target}");
            assert!(!(text.starts_with("docs/") && target.starts_with("..")), "{text} links to {target}");
            links += 1;
        }
    }
    assert!(links > 12, "{links} links in {texts:?}");
}

/// Files and options that the README names exist.
#[test]
fn the_readme_is_true() {
    let readme = fs::read_to_string(root().join("README.md")).expect("the README");
    let is_end = |c: char| c.is_whitespace() || "`()[]|,;".contains(c);
    let mut scenes = 0;
    for word in readme.split(is_end).filter(|w| w.starts_with("scenes/") || w.ends_with(".md")) {
        assert!(root().join(word).exists(), "the README names {word}");
        scenes += 1;
    }
    assert!(scenes >= 5, "the README names scenes to walk through");
    let list = Foveal::new("--help").ok().out;
    let names = list.split("Commands:").nth(1).and_then(|l| l.split("Options:").next()).unwrap_or_default();
    let names: Vec<&str> = names.lines().filter_map(|l| l.split_whitespace().next()).collect();
    for line in readme.lines().filter_map(|l| l.strip_prefix("| `foveal ")) {
        let name = line.split([' ', '`']).next().unwrap_or_default();
        assert!(names.contains(&name) || name == "view" && !cfg!(feature = "window"), "there is no {name}");
    }
    let of_commands = names.iter().filter(|n| **n != "help").map(|n| (*n).to_owned());
    let of_benches = ["stages", "error", "rays", "textures"].map(|what| format!("bench {what}"));
    let help: String =
        of_commands.chain(of_benches).map(|n| Foveal::new(&n).arg("--help").run().out).collect();
    let is_option = |w: &str| w.strip_prefix("--").is_some_and(|n| n.starts_with(char::is_alphabetic));
    let cargo = ["--release", "--example", "--no-default-features", "--test", "--ignored"];
    for option in readme.split(is_end).filter(|w| is_option(w) && !cargo.contains(w)) {
        // Of the window only.
        let absent = option == "--view" && !cfg!(feature = "window");
        assert!(help.contains(option) || absent, "the README names {option}");
    }
}
