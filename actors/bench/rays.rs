//! `foveal bench rays`: rays per second of processor time, with what obvhs' own traversal does beside it.
//!
//! Triangles and rays come from files, so that other programs can trace the same: a soup is `SOUP`, a version, numbers of
//! vertices and triangles (u32), camera and light (19 f32), positions and indices; rays are eight f32 each, origin, lower
//! bound, direction, upper bound. Without files they are made of the hall: primary rays in tiles of 8 × 8 pixels, from
//! each hit a diffuse bounce and a ray to a lamp.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use foveal::geometry::bvh::Accel;
use foveal::geometry::bvh_peers::{Peer, PeerTree};
use foveal::geometry::packet::LANES;
use foveal::geometry::shadow::{LastShadow, Shadows};
use foveal::geometry::{Hit, Ray};
use foveal::rng::Stream;
use foveal::scene::{Material, MaterialId, Mesh, Model, Reflectance, Scene};
use foveal::transport::light::{Lights, Receiver};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::made::MadeScene;
use foveal_engine::failure::Failure;
use foveal_engine::opened::load_scene;
use foveal_engine::process::cpu_ns;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, median};

/// Arguments of `foveal bench rays`.
#[derive(Args, Debug)]
pub struct RaysArguments {
    /// Triangles to trace against (default: a hall of 100,000)
    #[arg(long, value_name = "FILE", requires = "rays")]
    soup: Option<PathBuf>,
    /// Rays: a file NAME.KIND.rays, or the NAME of three (KIND: primary, bounce, shadow)
    #[arg(long, value_name = "FILE", requires = "soup")]
    rays: Option<PathBuf>,
    /// Numbers of threads
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "1,2")]
    threads: Vec<usize>,
    /// Results of another program for the same files, in lines of program,label,scene,kind,threads,rays,wall,cpu,wall
    /// rate,rate per processor second; the best of each kind is shown next to ours
    #[arg(long, value_name = "FILE")]
    beside: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArguments,
}

/// What stands beside ours.
const TREES: [PeerTree; 2] = [PeerTree::Binary, PeerTree::CompressedWide];
/// Rays that go to a thread at once.
const CHUNK: usize = 4096;
/// Rays that are traced before time is taken.
const WARMING: usize = 1 << 16;

/// What the rays are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RayKind {
    Primary,
    Bounce,
    Shadow,
}

impl RayKind {
    const ALL: [Self; 3] = [Self::Primary, Self::Bounce, Self::Shadow];

    const fn name(self) -> &'static str {
        match self {
            Self::Primary => "primary",
            Self::Bounce => "bounce",
            Self::Shadow => "shadow",
        }
    }
}

/// Triangles and sets of rays.
struct Job {
    name: String,
    scene: Scene,
    sets: Vec<(RayKind, Vec<Ray>)>,
}

/// Runs the benchmark.
pub fn run(a: &RaysArguments, progress: Progress) -> Result<(), Failure> {
    let job = match (&a.soup, &a.rays) {
        (Some(soup), Some(rays)) => from_files(soup, rays)?,
        _ => from_hall()?,
    };
    if a.threads.iter().any(|t| !(1..=64).contains(t)) {
        return Err(Failure::Usage("--threads: 1 to 64".into()));
    }
    let beside = a.beside.as_deref().map(|file| read_beside(file, &job.name)).transpose()?;
    let corners: Vec<[Vec3; 3]> =
        (0..job.scene.mesh.triangles.len() as u32).map(|t| job.scene.mesh.corners(t)).collect();
    let start = Instant::now();
    let accel = Accel::build(&job.scene);
    let build = start.elapsed().as_secs_f64();
    let peers = TREES.map(|tree| Peer::build(&corners, tree));
    let bar = progress.bar(u64::from(a.common.runs) * a.threads.len() as u64, "rays");
    let mut pools = Vec::new();
    for &threads in &a.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pools.push(pool.map_err(|e| Failure::Environment(format!("no threads: {e}")))?);
    }
    // By set and number of threads: ours, each peer, and ours where shadow rays go together.
    let mut rates = vec![vec![[(); 4].map(|()| Vec::new()); a.threads.len()]; job.sets.len()];
    let mut sums = vec![0u64; job.sets.len()];
    for _ in 0..a.common.runs {
        for (p, pool) in pools.iter().enumerate() {
            for (s, (kind, rays)) in job.sets.iter().enumerate() {
                let (rate, sum) = ours(pool, &job.scene, &accel, *kind, rays);
                rates[s][p][0].push(rate);
                sums[s] = sum;
                if *kind == RayKind::Shadow {
                    let (rate, together) = shadows_together(pool, &job.scene, &accel, rays);
                    if together != sum {
                        return Err(Failure::Check("shadow rays find other things together".to_owned()));
                    }
                    rates[s][p][3].push(rate);
                }
                for (i, peer) in peers.iter().enumerate() {
                    rates[s][p][i + 1].push(theirs(pool, peer, *kind, rays));
                }
            }
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    let mut rows = Vec::new();
    for (s, (kind, _)) in job.sets.iter().enumerate() {
        for (p, threads) in a.threads.iter().enumerate() {
            let [own, binary, wide, together] = &rates[s][p];
            let what = format!(
                "{}, {}, {threads} thread{}",
                job.name,
                kind.name(),
                if *threads == 1 { "" } else { "s" }
            );
            let best = [(TREES[0].name(), median(binary)), (TREES[1].name(), median(wide))]
                .into_iter()
                .max_by(|a, b| a.1.unwrap_or(0.0).total_cmp(&b.1.unwrap_or(0.0)));
            let row = Row::new(&what, "Mrays per CPU s", own);
            rows.push(match best {
                Some((peer, value)) => row.against(peer, value).aim(Aim::RatioAtLeast(1.0)),
                None => row,
            });
            for (label, of, rate) in beside.iter().flatten().filter(|b| b.1 == (kind.name().into(), *threads))
            {
                let _ = of;
                let row = Row::new(&what, "Mrays per CPU s", own).against(label, Some(*rate));
                let aim = if *kind == RayKind::Primary { 0.6 } else { 1.0 };
                rows.push(row.aim(Aim::RatioAtLeast(aim)));
                if *kind == RayKind::Shadow {
                    let row = Row::new(format!("{what}, sixteen together"), "Mrays per CPU s", together);
                    rows.push(row.against(label, Some(*rate)).aim(Aim::RatioAtLeast(1.0)));
                }
            }
            if *kind == RayKind::Shadow {
                let row = Row::new(format!("{what}, sixteen together"), "Mrays per CPU s", together);
                rows.push(row.against("one by one", median(own)));
            }
        }
    }
    rows.push(Row::new(format!("{}, tree of {} triangles", job.name, corners.len()), "s", &[build]));
    rows.push(Row::new("  size", "MiB", &[accel.size_bytes() as f64 / f64::from(1 << 20)]));
    let notes = job
        .sets
        .iter()
        .zip(&sums)
        .map(|((kind, rays), sum)| {
            format!("{} {} rays; their hits hash to {sum:016x}.", rays.len(), kind.name())
        })
        .collect::<Vec<_>>();
    finish("rays", &rows, &notes, &a.common)
}

/// Traces all chunks and returns millions of rays per second of processor time, with what each chunk found.
fn rate<R: Send>(
    pool: &rayon::ThreadPool,
    rays: &[Ray],
    trace: impl Fn(&[Ray]) -> R + Sync,
) -> (f64, Vec<R>) {
    pool.install(|| {
        let all = |rays: &[Ray]| rays.par_chunks(CHUNK).map(&trace).collect::<Vec<R>>();
        // Whoever was measured before left other things in the caches.
        std::hint::black_box(all(&rays[..rays.len().min(WARMING)]));
        let cpu = cpu_ns();
        let found = all(rays);
        (rays.len() as f64 * 1e3 / (cpu_ns() - cpu), found)
    })
}

fn digest(found: &[u64]) -> u64 {
    xxhash_rust::xxh3::xxh3_64(bytemuck::cast_slice(found))
}

/// Our rate, and a checksum of all hits.
fn ours(pool: &rayon::ThreadPool, scene: &Scene, accel: &Accel, kind: RayKind, rays: &[Ray]) -> (f64, u64) {
    let of_hit =
        |hit: Option<Hit>| hit.map_or(0, |h| (u64::from(h.triangle) + 1) << 32 | u64::from(h.t.to_bits()));
    let (rate, found) = match kind {
        RayKind::Primary => rate(pool, rays, |chunk| {
            let mut sum = 0u64;
            for rays in chunk.chunks(LANES) {
                let one_eye = rays.len() == LANES && rays.iter().all(|r| r.origin == rays[0].origin);
                if one_eye {
                    let directions = std::array::from_fn(|i| rays[i].direction);
                    for hit in accel.intersect_packet(scene, rays[0].origin, &directions) {
                        sum = sum.rotate_left(5) ^ of_hit(hit);
                    }
                } else {
                    for ray in rays {
                        sum = sum.rotate_left(5) ^ of_hit(accel.intersect(scene, ray));
                    }
                }
            }
            sum
        }),
        RayKind::Bounce => rate(pool, rays, |chunk| {
            chunk.iter().fold(0u64, |sum, ray| sum.rotate_left(5) ^ of_hit(accel.intersect(scene, ray)))
        }),
        RayKind::Shadow => rate(pool, rays, |chunk| {
            chunk.iter().fold(0u64, |sum, ray| sum.rotate_left(5) ^ u64::from(accel.occluded(scene, ray)))
        }),
    };
    (rate, digest(&found))
}

/// The same of shadow rays, sixteen that follow each other at a time.
fn shadows_together(pool: &rayon::ThreadPool, scene: &Scene, accel: &Accel, rays: &[Ray]) -> (f64, u64) {
    let (rate, found) = rate(pool, rays, |chunk| {
        let (mut sum, mut last) = (0u64, LastShadow::default());
        for rays in chunk.chunks(LANES) {
            let found = match rays.try_into() {
                Ok(packet) => accel.shadows(scene, packet, 0xffff, &mut last, |_| true),
                Err(_) => Shadows { blocked: 0, unclear: 0xffff },
            };
            for (lane, ray) in rays.iter().enumerate() {
                let is_alone = found.unclear >> lane & 1 != 0;
                let blocked =
                    if is_alone { accel.occluded(scene, ray) } else { found.blocked >> lane & 1 != 0 };
                sum = sum.rotate_left(5) ^ u64::from(blocked);
            }
        }
        sum
    });
    (rate, digest(&found))
}

fn theirs(pool: &rayon::ThreadPool, peer: &Peer, kind: RayKind, rays: &[Ray]) -> f64 {
    let (rate, found) = match kind {
        RayKind::Primary | RayKind::Bounce => rate(pool, rays, |chunk| {
            chunk.iter().map(|ray| f64::from(peer.intersect(ray).min(1e9))).sum::<f64>()
        }),
        RayKind::Shadow => {
            rate(pool, rays, |chunk| chunk.iter().filter(|ray| peer.occluded(ray)).count() as f64)
        }
    };
    std::hint::black_box(found);
    rate
}

fn from_files(soup: &Path, rays: &Path) -> Result<Job, Failure> {
    let scene = read_soup(soup)?;
    let text = rays.to_string_lossy();
    let kinds = RayKind::ALL.into_iter();
    let files: Vec<(RayKind, PathBuf)> = if text.ends_with(".rays") {
        let kind = kinds.filter(|k| text.ends_with(&format!("{}.rays", k.name()))).collect::<Vec<_>>();
        vec![(kind.first().copied().unwrap_or(RayKind::Bounce), rays.to_path_buf())]
    } else {
        kinds.map(|k| (k, PathBuf::from(format!("{text}.{}.rays", k.name())))).collect()
    };
    let sets = files.into_iter().map(|(kind, file)| Ok((kind, read_rays(&file)?)));
    let name = soup.file_stem().map_or_else(|| "soup".into(), |n| n.to_string_lossy().into_owned());
    Ok(Job { name, scene, sets: sets.collect::<Result<_, Failure>>()? })
}

fn read(file: &Path) -> Result<Vec<u8>, Failure> {
    std::fs::read(file).map_err(|e| Failure::Input(format!("{}: {e}", file.display())))
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect()
}

fn read_soup(file: &Path) -> Result<Scene, Failure> {
    let bytes = read(file)?;
    let broken = |what: &str| Failure::Input(format!("{}: {what}", file.display()));
    let word = |at: usize| {
        bytes
            .get(at..at + 4)
            .map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]]))
            .ok_or_else(|| broken("too short"))
    };
    if bytes.get(..4) != Some(b"SOUP") || word(4)? != 1 {
        return Err(broken("no triangle soup of version 1"));
    }
    let (vertices, triangles) = (word(8)? as usize, word(12)? as usize);
    let from = 16 + 19 * 4;
    let positions = bytes.get(from..from + vertices * 12).ok_or_else(|| broken("too short"))?;
    let indices = bytes
        .get(from + vertices * 12..)
        .and_then(|b| b.get(..triangles * 12))
        .ok_or_else(|| broken("too short"))?;
    let positions: Vec<Vec3> = floats(positions).chunks_exact(3).map(Vec3::from_slice).collect();
    let indices: Vec<u32> =
        indices.chunks_exact(4).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect();
    if indices.iter().any(|&i| i as usize >= vertices) {
        return Err(broken("an index beyond the vertices"));
    }
    Ok(plain_scene(positions, indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect()))
}

/// Opaque triangles of one material.
fn plain_scene(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Scene {
    let count = triangles.len();
    let material = Material::new("grey", Model::Lambert { albedo: Reflectance::constant(Vec3::splat(0.5)) });
    let mesh = Mesh {
        normals: vec![Vec3::ZERO; positions.len()],
        uvs: vec![Vec2::ZERO; positions.len()],
        uvs1: Vec::new(),
        tangents: Vec::new(),
        positions,
        triangles,
        materials: vec![MaterialId(0); count],
        objects: vec![0; count],
    };
    foveal::scene::SceneParts {
        name: "soup".into(),
        title: "soup".into(),
        bounds: mesh.bounds(),
        mesh,
        materials: vec![material],
        lights: Vec::new(),
        environment: None,
        cameras: Vec::new(),
        paths: Vec::new(),
        objects: Vec::new(),
        things: Default::default(),
        metres_per_unit: 1.0,
        up: Vec3::Y,
        display: Default::default(),
        budget: Default::default(),
        extensions: Vec::new(),
        content_hash: [0; 32],
        files: Vec::new(),
    }
    .with_textures(Vec::new())
}

fn read_rays(file: &Path) -> Result<Vec<Ray>, Failure> {
    let numbers = floats(&read(file)?);
    if numbers.is_empty() {
        return Err(Failure::Input(format!("{}: no rays", file.display())));
    }
    let ray = |r: &[f32]| Ray {
        t_min: r[3],
        t_max: r[7],
        ..Ray::new(Vec3::from_slice(r), Vec3::from_slice(&r[4..]))
    };
    Ok(numbers.chunks_exact(8).map(ray).collect())
}

/// Label, kind and number of threads, millions of rays per second of processor time.
type PeerRate = (String, (String, usize), f64);

fn read_beside(file: &Path, scene: &str) -> Result<Vec<PeerRate>, Failure> {
    let bytes = read(file)?;
    let beside = beside_of(&String::from_utf8_lossy(&bytes), scene);
    if beside.is_empty() {
        return Err(Failure::Input(format!(
            "{}: no line that says what another program does in {scene}",
            file.display()
        )));
    }
    Ok(beside)
}

/// The medians of the lines that are of a scene.
fn beside_of(lines: &str, scene: &str) -> Vec<PeerRate> {
    let mut by_key = std::collections::BTreeMap::<_, Vec<f64>>::new();
    for line in lines.lines() {
        let cells: Vec<&str> = line.split(',').collect();
        if let [program, label, of, kind, threads, _, _, _, _, rate, ..] = cells[..]
            && let (Ok(threads), Ok(rate)) = (threads.parse::<usize>(), rate.parse::<f64>())
            && of == scene
        {
            let key = (format!("{program}, {label}"), (kind.to_owned(), threads));
            by_key.entry(key).or_default().push(rate);
        }
    }
    by_key.into_iter().filter_map(|((label, of), rates)| Some((label, of, median(&rates)?))).collect()
}

/// The hall and its rays.
fn from_hall() -> Result<Job, Failure> {
    const SIDE: u32 = 512;
    let made = MadeScene::hall(100_000)?;
    let scene = load_scene(made.path())?.0;
    let accel = Accel::build(&scene);
    let lights = Lights::build(&scene);
    let frame = foveal_engine::opened::camera(&scene, None)?.camera.frame(SIDE, SIDE);
    let mut primary = Vec::new();
    for tile in 0..(SIDE / 8) * (SIDE / 8) {
        let (x, y) = (tile % (SIDE / 8) * 8, tile / (SIDE / 8) * 8);
        for pixel in 0..64 {
            let (px, py) = ((x + pixel % 8) as f32 + 0.5, (y + pixel / 8) as f32 + 0.5);
            primary.push(Ray::new(frame.eye, frame.direction(px, py)));
        }
    }
    let (mut bounce, mut shadow) = (Vec::new(), Vec::new());
    let lift = 1e-4 * scene.diagonal();
    for (i, ray) in primary.iter().enumerate() {
        let Some(hit) = accel.intersect(&scene, ray) else { continue };
        let [a, b, c] = scene.mesh.corners(hit.triangle);
        let n = (b - a).cross(c - a).normalize_or_zero();
        let n = if n.dot(ray.direction) > 0.0 { -n } else { n };
        let p = ray.at(hit.t) + n * lift;
        let mut s = Stream::new(7, i as u64, 0);
        // Cosine distribution: a point of the unit sphere around the normal's tip.
        let (z, phi) = (1.0 - 2.0 * s.next_f32(), std::f32::consts::TAU * s.next_f32());
        let r = (1.0 - z * z).max(0.0).sqrt();
        let d = (n + Vec3::new(r * phi.cos(), r * phi.sin(), z)).try_normalize().unwrap_or(n);
        bounce.push(Ray::new(p, d));
        let at = Receiver { point: p, normal: n };
        if let Some(light) = lights.sample_towards(&scene, &at, (s.next_f64(), s.next_2d()), None) {
            shadow.push(Ray { t_max: light.distance * 0.999, ..Ray::new(p, light.wi) });
        }
    }
    let sets = vec![(RayKind::Primary, primary), (RayKind::Bounce, bounce), (RayKind::Shadow, shadow)];
    let sets = sets.into_iter().filter(|s| !s.1.is_empty()).collect();
    let scene = plain_scene(scene.mesh.positions.clone(), scene.mesh.triangles.clone());
    Ok(Job { name: "hall".into(), scene, sets })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file may hold the figures of several scenes, several rounds of each, and lines that say something else.
    #[test]
    fn figures_beside_are_those_of_the_scene() {
        let line = |scene: &str, rate: f64| {
            format!("embree,packets,{scene},shadow,1,100,0.1,0.1,9,{rate},7,1,1,1\n")
        };
        let lines = [
            "program,label,scene\n".into(),
            line("room", 3.0),
            line("hair", 90.0),
            line("room", 1.0),
            line("room", 2.0),
        ];
        let told = beside_of(&lines.concat(), "room");
        assert_eq!(told, [("embree, packets".to_owned(), ("shadow".to_owned(), 1), 2.0)]);
        assert!(beside_of(&lines.concat(), "kitchen").is_empty());
    }
}
