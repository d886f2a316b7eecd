//! `foveal bench scaling --tracers`: what guests of one core add to a reference and a bake, and how long it takes to come to a
//! large scene.

use std::path::Path;
use std::time::{Duration, Instant};

use foveal::geometry::Accel;
use foveal::illumination::Uniform;
use foveal::illumination::bake::{BakeSettings, Baker};
use foveal::world::World;
use foveal_engine::batch::{Alone, Handed, Hands};
use foveal_engine::failure::Failure;
use foveal_engine::light::Reading;
use foveal_engine::opened::{camera, load_scene};
use foveal_engine::reference::{Enough, sampled_paths_by};
use foveal_remote::hands::Helped;
use foveal_remote::key::Key;
use foveal_remote::package::Package;
use foveal_terminal::table::{Aim, Row, median};
use glam::Vec3;
use rayon::ThreadPool;
use std::sync::Arc;

use super::made::MadeScene;
use super::remote::{comes, guest, guests, helpers};

/// Triangles of a scene whose files are a hundred mebibytes.
const TRIANGLES: usize = 2_600_000;

/// Time that a guest has to keep a scene.
const KEEPS: Duration = Duration::from_secs(60);

/// Whether a guest has kept the scene, whose files it has there, as it was read.
fn is_kept(stock: &Path) -> bool {
    let mut kept = std::fs::read_dir(stock.join("remote/scenes")).into_iter().flatten().flatten();
    kept.any(|entry| entry.path().extension().is_some_and(|e| e == "fvscene"))
}

fn world(path: &Path) -> Result<World, Failure> {
    let (scene, _) = load_scene(path)?;
    Ok(World::new(scene, Arc::new(Uniform(Vec3::ZERO))))
}

fn helped(link: &str, guests: u32, path: &Path, world: &World) -> Result<Helped, Failure> {
    let package = Package::without_light(path, &Reading::default(), world.scene.content_hash)?;
    let key = Key::new().map_err(Failure::Environment)?;
    Helped::open(&format!("{link}/127.0.0.1:0"), key, package, guests, 64)
}

/// Seconds of each of so many references and bakes; the first is where both sides learn, and does not count.
fn timed(pool: &ThreadPool, hands: &dyn Hands, world: &World, runs: u32) -> Result<[Vec<f64>; 2], Failure> {
    let frame = camera(&world.scene, None)?.camera.frame(256, 256);
    let settings =
        BakeSettings { texels: 32 << 10, particles: Some(1 << 19), error: None, ..BakeSettings::default() };
    let mut seconds = [Vec::new(), Vec::new()];
    for run in 0..=runs {
        let began = Instant::now();
        pool.install(|| sampled_paths_by(hands, world, &frame, 7, &Enough::samples(4), &|| true));
        let reference = began.elapsed().as_secs_f64();
        let began = Instant::now();
        pool.install(|| {
            let mut baker = Baker::new(world.indexed(), &settings);
            let handed = Handed { hands, settings: &settings };
            baker.run_by(world.indexed(), &handed, &|_| true, &mut |_| {});
        });
        if run > 0 {
            seconds[0].push(reference);
            seconds[1].push(began.elapsed().as_secs_f64());
        }
    }
    Ok(seconds)
}

/// What numbers of guests add to a reference and to a bake, over each link.
pub fn rows(links: &[String], numbers: &[u32], runs: u32, apart: bool) -> Result<Vec<Row>, Failure> {
    let made = MadeScene::bundled("table")?;
    let world = world(made.path())?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let pool = pool.map_err(|e| Failure::Environment(format!("no thread: {e}")))?;
    let alone = timed(&pool, &Alone, &world, runs)?;
    let names = ["table, a reference of 4 paths a pixel, one core", "table, a bake of 2¹⁹ paths, one core"];
    let mut rows: Vec<Row> = names.iter().zip(&alone).map(|(name, s)| Row::new(*name, "s", s)).collect();
    for (link, &number) in links.iter().flat_map(|link| numbers.iter().map(move |number| (link, number))) {
        let helped = helped(link, number, made.path(), &world)?;
        let come = guests(number, helped.invitation(), apart, || helped.serving())?;
        let with = timed(&pool, &helped, &world, runs)?;
        drop((helped.close(), come));
        for (what, (own, with)) in ["reference", "bake"].iter().zip(alone.iter().zip(&with)) {
            let own = median(own).unwrap_or(f64::NAN);
            let gains: Vec<f64> = with.iter().map(|seconds| own / seconds).collect();
            let gain = Row::new(format!("  {what} {}: gain", helpers(number, link)), "×", &gains);
            rows.push(if number == 1 { gain.aim(Aim::AtLeast(1.8)) } else { gain });
        }
    }
    Ok(rows)
}

/// How long it takes a guest to come to a scene of a hundred mebibytes, at first and again, over each link.
pub fn joins(links: &[String], apart: bool) -> Result<Vec<Row>, Failure> {
    let made = MadeScene::hall(TRIANGLES)?;
    let began = Instant::now();
    let (scene, _) = load_scene(made.path())?;
    let read = began.elapsed().as_secs_f64();
    let began = Instant::now();
    let index = Accel::build(&scene);
    let indexed = began.elapsed().as_secs_f64();
    drop(index);
    let world = World::new(scene, Arc::new(Uniform(Vec3::ZERO)));
    let (name, mut rows) = ("  a guest comes", Vec::new());
    for link in links {
        let helped = helped(link, 1, made.path(), &world)?;
        if rows.is_empty() {
            let mib = helped.package_bytes() as f64 / f64::from(1 << 20);
            rows.push(Row::new(format!("hall of {} triangles, its files", made.triangles), "MiB", &[mib]));
            rows.push(Row::new("  read here, one core", "s", &[read]));
            rows.push(Row::new("  its index made here, one core", "s", &[indexed]));
        }
        let stock = made.path().with_extension(format!("{link}-stock"));
        for when in ["at first", "again"] {
            let began = Instant::now();
            let mut guest =
                guest(helped.invitation(), &["--cache".as_ref(), stock.as_os_str()], apart.then_some(1))?;
            comes(&mut guest, || helped.serving() > 0)?;
            let took = began.elapsed().as_secs_f64();
            let row = Row::new(format!("{name} over {link}, {when}"), "s", &[took]);
            if when == "again" {
                // Its index is kept with the scene.
                rows.push(row.aim(Aim::AtMost(1.0)));
            } else {
                let bare = Row::new(
                    format!("{name} over {link}, {when}, without its index"),
                    "s",
                    &[took - indexed],
                );
                rows.extend([row, bare.aim(Aim::AtMost(3.0))]);
            }
            // It keeps what it has read beside its work.
            while began.elapsed() < KEEPS && !is_kept(&stock) {
                std::thread::sleep(Duration::from_millis(10));
            }
            drop(guest);
            while helped.serving() > 0 {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        drop(helped.close());
    }
    Ok(rows)
}
