//! A walk on a thread of its own: what a user does goes in, the newest picture comes out.
//! `cargo run -p foveal-engine --example beside -- scenes/box/box.toml out.png`

use std::path::PathBuf;
use std::time::Duration;

use foveal_engine::files::{png_bytes, write_atomic};
use foveal_engine::navigation::Motion;
use foveal_engine::thread::{Command, EngineThread};
use foveal_engine::walk::Act;
use foveal_engine::{Failure, Recipe, Settings};

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(scene), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err(Failure::Usage("beside SCENE PICTURE.png".into()));
    };
    let recipe = Recipe::new(scene, Settings::new(320, 240, 2));
    let here = std::thread::current();
    // The scene is read over there, too. Whenever there is something new, this thread is woken.
    let walk = EngineThread::spawn(move || recipe.walk(&()), move || here.unpark())?;
    let handle = walk.handle();
    // A step forward, as a key would do it, and a look around. The mark is found again in the picture that shows it.
    let tell = |act, mark| handle.send(Command::Act { act, at: handle.now(), mark });
    let full = |_| Failure::Environment("too many commands wait".into());
    tell(Act::Press(Motion::Forward), 1.0).map_err(full)?;
    std::thread::sleep(Duration::from_millis(200));
    tell(Act::Release(Motion::Forward), 2.0).map_err(full)?;
    tell(Act::Look(40.0, 0.0), 3.0).map_err(full)?;
    while !handle.is_over() {
        let Some(shown) = handle.shown() else {
            std::thread::park_timeout(Duration::from_millis(100));
            continue;
        };
        println!("picture {}: {}", shown.number, if shown.exact { "exact" } else { "on its way" });
        // It knows of all that was done, and rays correct nothing more of it.
        if shown.exact && shown.mark == Some(3.0) {
            let (width, height) = (shown.picture.width() as u32, shown.picture.height() as u32);
            write_atomic(&out, &png_bytes(width, height, shown.picture.data().as_flattened())?)?;
            break;
        }
    }
    walk.end().map_err(|why| Failure::ended(&why))
}
