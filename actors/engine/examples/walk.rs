//! Walks around a scene and writes the last frame: `cargo run -p foveal-engine --example walk -- scenes/box/box.toml out.png`

use std::path::PathBuf;
use std::time::Duration;

use foveal_engine::files::{png_bytes, write_atomic};
use foveal_engine::{Engine, Failure, Options, Settings};

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(scene), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err(Failure::Usage("walk SCENE PICTURE.png".into()));
    };
    let mut walk = Engine::open(&scene, Options::new(Settings::new(320, 240, 2)), &())?;
    let scene = walk.opened().world.scene.clone();
    let start = scene.cameras[0].camera;
    for number in 0..10 {
        let seconds = 0.1 * number as f32;
        let camera = scene.paths.first().map_or(start, |path| path.at(seconds, start.up, start.fov_y));
        let frame = walk.frame(&camera, Duration::from_millis(100))?;
        let picture = &frame.snapshot.rgb8;
        let (width, height) = (picture.width() as u32, picture.height() as u32);
        write_atomic(&out, &png_bytes(width, height, picture.data().as_flattened())?)?;
        println!("frame {number}: {} samples, {}", frame.counts.traced, frame.standing.name());
    }
    Ok(())
}
