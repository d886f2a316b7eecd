//! `foveal bench simplify`: a radiosity mesh cut back to k elements by what is measured and by what is seen (Dumont et
//! al. 2003 §6.4, figure 18): how far views of each are from views of the whole mesh.

use std::sync::Arc;

use clap::Args;
use foveal::allocation::mesh_elements::{ElementCriterion, simplify_mesh};
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::tone::{Encoder, ToneMap};
use foveal::display::{FrameBuffers, PrimaryHit};
use foveal::image::Map2d;
use foveal::metrics::flip;
use foveal::radiosity::mesh::RadiosityMesh;
use foveal::radiosity::of_scene::SceneRadiosity;
use foveal::scene::Scene;
use foveal::scene::camera::Camera;
use foveal::world::World;
use glam::Vec3;

use super::made::MadeScene;
use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, png_bytes, write_atomic};
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened::load_scene;
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish};

/// Views that are compared.
const VIEWS: usize = 10;
/// Of so many of them the perceptual criterion should be nearer to the whole mesh.
const WINS: f64 = 9.0;
/// FLIP that the picture shows as white.
const FLIP_SHOWN: f32 = 0.25;

/// Arguments of `foveal bench simplify`.
#[derive(Args, Debug)]
pub struct SimplifyArguments {
    /// Scene with area lights (default: a papered salon)
    #[arg(value_name = "SCENE")]
    scene: Option<std::path::PathBuf>,
    /// Minimum number of elements of the full mesh
    #[arg(long, value_name = "N", default_value_t = 41_000)]
    from: usize,
    /// Number of elements to simplify it to
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    elements: usize,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "480x360")]
    size: Size,
    #[command(flatten)]
    common: CommonArguments,
}

/// A mesh and what its views look like.
struct ShownMesh {
    name: &'static str,
    solution: SceneRadiosity,
    mesh: Arc<RadiosityMesh>,
    elements: usize,
    views: Vec<Map2d<Vec3>>,
}

/// Ten cameras of the scene, or as many places along its path.
fn views(scene: &Scene) -> Vec<Camera> {
    match scene.paths.first() {
        Some(path) if scene.cameras.len() < VIEWS => {
            let Some(camera) = scene.cameras.first().map(|c| c.camera) else { return Vec::new() };
            let at = |i: usize| path.at(path.duration() * i as f32 / VIEWS as f32, camera.up, camera.fov_y);
            (0..VIEWS).map(at).collect()
        }
        _ => scene.cameras.iter().take(VIEWS).map(|c| c.camera).collect(),
    }
}

/// Runs the benchmark.
pub fn run(a: &SimplifyArguments, progress: Progress) -> Result<(), Failure> {
    let made = a.scene.is_none().then(MadeScene::salon).transpose()?;
    let file = a.scene.as_deref().or(made.as_ref().map(MadeScene::path)).unwrap_or(std::path::Path::new(""));
    let (scene, _) = load_scene(file)?;
    let cameras = views(&scene);
    let bar = progress.bar(5, "meshes");
    let world = World::new(scene.clone(), Arc::new(foveal::illumination::Uniform(Vec3::ZERO)));
    let mut whole = SceneRadiosity::new(&scene, &world.accel).map_err(Failure::Input)?;
    while whole.leaf_count() < a.from && !whole.is_exhausted() && !interrupted() {
        whole.refine_towards(&scene, &world.accel, a.from);
    }
    bar.inc(1);
    let size = [a.size.width, a.size.height];
    let shown = |name, solution: SceneRadiosity, elements| {
        let mesh = Arc::new(solution.mesh(&scene));
        let lit = world.with_illumination(mesh.clone());
        ShownMesh {
            name,
            views: cameras.iter().map(|c| drawn(&lit, c, size).0).collect(),
            solution,
            mesh,
            elements,
        }
    };
    let leaves = whole.leaf_count();
    let all = shown("all elements", whole, leaves);
    bar.inc(1);
    let mut cut = Vec::new();
    for (name, criterion) in [
        ("photometric", ElementCriterion::Photometric),
        ("perceptual", ElementCriterion::Perceptual),
        ("optimal", ElementCriterion::Optimal),
    ] {
        let mut mesh = all.solution.clone();
        let simplified = simplify_mesh(&mut mesh, &scene, a.elements, criterion);
        cut.push(shown(name, mesh, simplified.elements));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let tone = ToneMap::from(&scene.display);
    let maps: Vec<Vec<Map2d<f32>>> = cut
        .iter()
        .map(|cut| {
            all.views.iter().zip(&cut.views).map(|(whole, cut)| flip::flip(whole, cut, &tone)).collect()
        })
        .collect();
    let means: Vec<Vec<f64>> = maps.iter().map(|maps| maps.iter().map(flip::mean).collect()).collect();
    let mut rows = Vec::new();
    for cut in &cut {
        rows.push(Row::new(format!("elements left of {leaves} ({})", cut.name), "", &[cut.elements as f64]));
    }
    for (view, (photometric, perceptual)) in means[0].iter().zip(&means[1]).enumerate() {
        let what = format!("view {}: mean FLIP, perceptual", view + 1);
        rows.push(Row::new(what, "", &[*perceptual]).against("photometric", Some(*photometric)));
    }
    rows.push(
        Row::new("all views: mean FLIP, perceptual", "", &means[1])
            .against("photometric", foveal_terminal::table::median(&means[0])),
    );
    rows.push(
        Row::new("all views: mean FLIP, optimal", "", &means[2])
            .against("photometric", foveal_terminal::table::median(&means[0])),
    );
    let won =
        means[0].iter().zip(&means[1]).filter(|(photometric, perceptual)| perceptual < photometric).count()
            as f64;
    let row =
        Row::new(format!("views of {} in which the perceptual mesh is nearer", cameras.len()), "", &[won]);
    rows.push(row.aim(Aim::AtLeast(WINS * cameras.len() as f64 / VIEWS as f64)));
    if let Some(out) = &a.common.out {
        make_folder(out)?;
        for (view, camera) in cameras.iter().enumerate() {
            let picture = side_by_side(&world, &scene, &all, &cut, &maps, (view, camera), size);
            let name = format!("simplified-{}.png", view + 1);
            write_atomic(&out.join(name), &png_bytes(3 * size[0], 3 * size[1], &picture)?)?;
        }
    }
    let notes = vec![format!(
        "{}, FLIP to the picture of the whole mesh of {leaves} elements, {} × {} pixels",
        scene.title, size[0], size[1]
    )];
    finish("simplify", &rows, &notes, &a.common)
}

/// A view, and where its pixels end.
fn drawn(world: &World, camera: &Camera, [width, height]: [u32; 2]) -> (Map2d<Vec3>, Map2d<PrimaryHit>) {
    let mut buffers = FrameBuffers::new(width as usize, height as usize);
    cpu_pass::draw(world, &camera.frame(width, height), Passes { texture_ids: false }, &mut buffers);
    (buffers.color, buffers.hit)
}

/// Rows: the whole mesh, by photometry, by perception. Columns: what is shown, the elements, FLIP to the whole mesh. Rows
/// of sRGB triples.
fn side_by_side(
    world: &World,
    scene: &Scene,
    all: &ShownMesh,
    cut: &[ShownMesh],
    maps: &[Vec<Map2d<f32>>],
    (view, camera): (usize, &Camera),
    size: [u32; 2],
) -> Vec<u8> {
    let (tone, encoder) = (ToneMap::from(&scene.display), Encoder::default());
    let [width, height] = size.map(|s| s as usize);
    let (_, hits) = drawn(world, camera, size);
    let frame = camera.frame(size[0], size[1]);
    let mut bytes = Vec::with_capacity(27 * width * height);
    for (row, shown) in [all, &cut[0], &cut[1]].into_iter().enumerate() {
        let element = |x: usize, y: usize| {
            let (x, y) = (x.min(width - 1), y.min(height - 1));
            let hit = hits.at(x, y);
            let [a, b, c] = scene.mesh.corners(hit.triangle);
            let back = (b - a).cross(c - a).dot(frame.direction(x as f32 + 0.5, y as f32 + 0.5)) > 0.0;
            (hit.triangle, shown.mesh.element_at(hit.triangle, hit.b1, hit.b2, back))
        };
        for y in 0..height {
            for x in 0..width {
                bytes.extend(encoder.rgb8(&tone, shown.views[view].at(x, y)));
            }
            for x in 0..width {
                let here = element(x, y);
                let is_edge = element(x + 1, y) != here || element(x, y + 1) != here;
                let radiance = shown.views[view].at(x, y) * if is_edge { 0.25 } else { 1.0 };
                bytes.extend(encoder.rgb8(&tone, radiance));
            }
            for x in 0..width {
                let error = row.checked_sub(1).map_or(0.0, |of| maps[of][view].at(x, y));
                bytes.extend([(255.0 * (error / FLIP_SHOWN).min(1.0)) as u8; 3]);
            }
        }
    }
    bytes
}
