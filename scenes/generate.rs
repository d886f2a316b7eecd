//! Writes the bundled scenes, and rooms too large to keep.
//!
//! `cargo run --release --example scenes -- OUT [--kinds] [--large]`: a folder per scene under OUT. What lies
//! in `scenes/` is its output; `--kinds` adds rooms of one kind of light each, `--large` rooms of 100 thousand,
//! 300 thousand and 1 million triangles.

use std::path::PathBuf;
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut out = None;
    let (mut kinds, mut large) = (false, false);
    for argument in std::env::args().skip(1) {
        if argument == "--large" {
            large = true;
        } else if argument == "--kinds" {
            kinds = true;
        } else if argument.starts_with('-') || out.is_some() {
            eprintln!("usage: scenes OUT [--kinds] [--large]");
            return ExitCode::from(2);
        } else {
            out = Some(PathBuf::from(argument));
        }
    }
    let Some(out) = out else {
        eprintln!("usage: scenes OUT [--kinds] [--large]");
        return ExitCode::from(2);
    };
    let sizes: &[usize] = if large { &[100_000, 300_000, 1_000_000] } else { &[] };
    let bundled = foveal_scenes::BUNDLED.iter().map(|(_, make)| make());
    let kinds = foveal_scenes::KINDS.iter().filter(|_| kinds).map(|(_, make)| make());
    for scene in bundled.chain(kinds).chain(sizes.iter().map(|&n| foveal_scenes::hall(n))) {
        let scene = match scene {
            Ok(scene) => scene,
            Err(error) => {
                eprintln!("a texture could not be encoded: {error}");
                return ExitCode::FAILURE;
            }
        };
        let folder = out.join(&scene.name);
        let written = std::fs::create_dir_all(&folder).and_then(|()| {
            scene.files.iter().try_for_each(|(name, bytes)| std::fs::write(folder.join(name), bytes))
        });
        if let Err(error) = written {
            eprintln!("{}: {error}", folder.display());
            return ExitCode::FAILURE;
        }
        let bytes: usize = scene.files.iter().map(|(_, bytes)| bytes.len()).sum();
        println!("{:10} {:8} triangles {:9} bytes", scene.name, scene.triangle_count, bytes);
    }
    ExitCode::SUCCESS
}
