//! `foveal bench first-light`: from a loaded scene to its first lit picture: lights, quick illumination, one frame; and whole
//! processes ([`crate::starts`]), the first start with nothing kept and the second.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::geometry::Accel;
use foveal::illumination::first::first_picture;
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal::world::World;

use super::made::MadeScene;
use super::{starts, timed};
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened::{camera, load_scene};
use foveal_engine::process::cpu_ns;
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish};

/// Scenes of more triangles have no aim.
const TRIANGLES: usize = 500_000;

/// Arguments of `foveal bench first-light`.
#[derive(Args, Debug)]
pub struct FirstLightArguments {
    /// Scene files (default: the bundled ones and a hall of 300,000 triangles)
    #[arg(value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: Size,
    /// Another build of foveal, measured in alternation with this one
    #[arg(long, value_name = "PROGRAM")]
    before: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArguments,
}

/// Runs the benchmark.
pub fn run(a: &FirstLightArguments, progress: Progress) -> Result<(), Failure> {
    let mut made = Vec::new();
    if a.scenes.is_empty() {
        for (name, _) in foveal_scenes::BUNDLED {
            made.push(MadeScene::bundled(name)?);
        }
        made.push(MadeScene::hall(300_000)?);
    }
    let files: Vec<PathBuf> =
        a.scenes.iter().cloned().chain(made.iter().map(|m| m.path().to_path_buf())).collect();
    let bar = progress.bar(files.len() as u64, "scenes");
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as f64;
    let mut rows = Vec::new();
    for file in &files {
        let (scene, _) = load_scene(file)?;
        let triangles = scene.mesh.triangles.len();
        let view = camera(&scene, None)?.camera;
        let (mut walls, mut shares) = (Vec::new(), Vec::new());
        for _ in 0..a.common.runs.max(1) {
            let busy = cpu_ns();
            let (index_ms, accel) = timed(|| Arc::new(Accel::build(&scene)));
            let (light_ms, world) = timed(|| {
                let lights = Arc::new(Lights::build(&scene));
                let map = first_picture(Indexed { scene: &scene, accel: &accel, lights: &lights }, 1);
                World::of(scene.clone(), accel.clone(), lights, Arc::new(map))
            });
            let (draw_ms, ()) = timed(|| {
                let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
                cpu_pass::draw(
                    &world,
                    &view.frame(a.size.width, a.size.height),
                    Passes { texture_ids: false },
                    &mut buffers,
                );
            });
            walls.push((index_ms + light_ms + draw_ms) * 1e-3);
            shares.push((cpu_ns() - busy) * 1e-9 / cores);
        }
        let row = Row::new(format!("{}, {triangles} triangles: first light", scene.name), "s", &walls);
        rows.push(if triangles <= TRIANGLES { row.aim(Aim::AtMost(1.0)) } else { row });
        rows.push(Row::new(format!("{}: the same, processor time of all cores", scene.name), "s", &shares));
        let of = (file.as_path(), scene.name.as_str(), triangles);
        rows.extend(starts::rows(of, a.size, a.common.runs, a.before.as_deref())?);
        bar.inc(1);
        if interrupted() {
            break;
        }
    }
    bar.finish_and_clear();
    let notes = vec![
        format!(
            "First light is the geometry index, the lights, the quick illumination and a frame of {} × {} pixels.",
            a.size.width, a.size.height
        ),
        "Starts are processes that walk one frame at 10 frames per second; the system has the scene's files in its memory."
            .to_owned(),
    ];
    finish("first-light", &rows, &notes, &a.common)
}
