//! The whole path of the sample behind a pixel, traced again on demand: surfaces, lobes, lights, random numbers and what
//! each adds; told in lines, as a document, and as lines over the picture.

use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::trace::retrace;
use foveal::transport::tracer::witness::{Event, Path, Step};
use foveal_actors::message::{DrawnView, SampleOrder};
use glam::Vec3;
use serde_json::{Value, json};

/// Of the picture's width or height at least as many pixels, where a path is drawn over it.
const DRAWN_SIDE_MIN: usize = 640;

/// A stretch of a path over the picture: columns and rows, and how much of the sample's light came along it, in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Where it begins and ends, pixels.
    pub ends: [[f32; 2]; 2],
    /// The share of the sample's light that came along it.
    pub share: f32,
    /// It leads to a sample of a light.
    pub to_light: bool,
}

/// A sample traced again.
pub(super) struct Traced {
    scene_names: Vec<String>,
    materials: Vec<String>,
    pixel: [u16; 2],
    view: u32,
    seed: u64,
    /// What the recording has.
    sample: Vec3,
    again: Vec3,
    path: Path,
    diagonal: f32,
}

impl Traced {
    /// Traces the sample of a job through `pixel` again, of which the recording says that it is `sample`.
    pub(super) fn again(job: &SampleOrder, pixel: [u16; 2], sample: Vec3) -> Option<Self> {
        let DrawnView { world, frame, view, .. } = &*job.drawn;
        let buffers = job.drawn.buffers();
        let (again, path) = retrace(world, frame, buffers, pixel, job.seed)?;
        let (objects, materials) = (&world.scene.objects, &world.scene.materials);
        Some(Self {
            scene_names: objects.iter().map(|o| o.name.clone()).collect(),
            materials: materials.iter().map(|m| m.name.clone()).collect(),
            diagonal: world.scene.diagonal(),
            pixel,
            view: view.0,
            seed: job.seed,
            sample,
            again,
            path,
        })
    }

    /// As a document.
    pub(super) fn document(&self) -> Value {
        let (through, added) = (self.path.throughput(), self.path.added());
        let steps = self.path.steps.iter().enumerate().map(|(number, step)| {
            let mut told = self.event(step);
            told["part_of"] = json!(step.parent);
            if !step.numbers.is_empty() {
                told["random_numbers"] = json!(step.numbers);
            }
            told["throughput"] = json!(through[number].to_array());
            told["adds"] = json!(added[number].to_array());
            told
        });
        json!({
            "pixel": self.pixel,
            "view": self.view,
            "seed": self.seed,
            "sample": self.sample.to_array(),
            "again": self.again.to_array(),
            "same": self.sample.to_array().map(f32::to_bits) == self.again.to_array().map(f32::to_bits),
            "steps": steps.collect::<Vec<_>>(),
        })
    }

    fn event(&self, step: &Step) -> Value {
        let named = |names: &[String], number: u32| names.get(number as usize).cloned().unwrap_or_default();
        match &step.event {
            Event::Sample => json!({"is": "sample"}),
            Event::Surface { object, material, position, normal, distance, depth } => json!({
                "is": "surface",
                "depth": depth,
                "object": object,
                "name": named(&self.scene_names, *object),
                "material": named(&self.materials, material.0),
                "position": position.to_array(),
                "normal": normal.to_array(),
                "distance": distance,
            }),
            Event::Escaped { direction } => json!({"is": "surroundings", "direction": direction.to_array()}),
            Event::Lobe { delta, transmitted, direction, pdf } => json!({
                "is": "ray",
                "lobe": if *delta { "one direction" } else { "glossy" },
                "way": if *transmitted { "through" } else { "reflected" },
                "direction": direction.to_array(),
                "pdf": pdf,
            }),
            Event::Glossy { rays, lights } => json!({"is": "glossy", "rays": rays, "light_samples": lights}),
            Event::Layer { number } => json!({"is": "layer", "number": number}),
            Event::Band { color } => json!({"is": "band", "color": color.to_array()}),
            Event::Roulette { survival, drawn } => {
                json!({"is": "roulette", "survival": survival, "drawn": drawn, "goes_on": drawn < survival})
            }
            Event::Light { direction, pdf, weight, blocked } => json!({
                "is": "light",
                "direction": direction.to_array(),
                "pdf": pdf,
                "weight": weight,
                "blocked": blocked,
            }),
            Event::Emission => json!({"is": "emission"}),
            Event::Diffuse => json!({"is": "stored light"}),
            Event::Through => json!({"is": "stored light behind"}),
            Event::Coat => json!({"is": "coat"}),
        }
    }

    /// What lies over a picture that is seen from `frame`.
    pub(super) fn segments(&self, frame: &CameraFrame) -> Vec<Segment> {
        let added = self.path.added();
        let brightest = |light: Vec3| light.abs().max_element();
        let whole = brightest(self.again).max(f32::MIN_POSITIVE);
        // Where the rays that begin at each step begin, and where its own ray ended.
        let mut at: Vec<Vec3> = Vec::with_capacity(self.path.steps.len());
        let mut all = Vec::new();
        let far = 0.3 * self.diagonal;
        for (number, step) in self.path.steps.iter().enumerate() {
            let here = step.parent.map_or(frame.eye, |parent| at[parent]);
            at.push(here);
            let (to, of) = match (&step.event, step.parent) {
                (Event::Surface { position, .. }, Some(parent)) => {
                    at[parent] = *position;
                    if parent == 0 {
                        // What is looked at lies in the pixel itself.
                        continue;
                    }
                    (*position, parent)
                }
                (Event::Escaped { direction }, _) => (here + *direction * far, number),
                (Event::Light { direction, blocked: false, .. }, _) => (here + *direction * far, number),
                _ => continue,
            };
            let share = (brightest(added[of]) / whole).min(1.0);
            let to_light = matches!(step.event, Event::Light { .. });
            all.extend(within(frame, [here, to]).map(|ends| Segment { ends, share, to_light }));
        }
        all
    }
}

/// A stretch of space in a picture, as far as it lies before the eye.
fn within(frame: &CameraFrame, [mut a, mut b]: [Vec3; 2]) -> Option<[[f32; 2]; 2]> {
    const NEAR: f32 = 1e-3;
    let depth = |p: Vec3| (p - frame.eye).dot(frame.forward);
    let near = NEAR * (depth(a).max(depth(b)));
    if near <= 0.0 || near.is_nan() {
        return None;
    }
    let (da, db) = (depth(a), depth(b));
    let cut = |from: Vec3, to: Vec3, from_depth: f32, to_depth: f32| {
        from + (to - from) * ((near - from_depth) / (to_depth - from_depth))
    };
    if da < near {
        a = cut(a, b, da, db);
    } else if db < near {
        b = cut(b, a, db, da);
    }
    let at = |p: Vec3| frame.project(p).map(|(x, y, _)| [x, y]);
    Some([at(a)?, at(b)?])
}

/// The document in lines; steps that add nothing and lead nowhere are left out.
pub(super) fn told(path: &Value) -> Vec<String> {
    let Some(steps) = path["steps"].as_array() else { return Vec::new() };
    let number = |v: &Value| v.as_f64().unwrap_or_default();
    let band = |v: &Value| format!("{:.4} {:.4} {:.4}", number(&v[0]), number(&v[1]), number(&v[2]));
    let same = match path["same"].as_bool() {
        Some(true) => "traced again: the same bits",
        _ => "traced again, to OTHER bits",
    };
    let mut lines = vec![format!(
        "path      pixel {},{} of view {}, seed {}: {}, {same}",
        path["pixel"][0],
        path["pixel"][1],
        path["view"],
        path["seed"],
        band(&path["again"])
    )];
    let mut depths: Vec<usize> = Vec::with_capacity(steps.len());
    for step in steps {
        let depth = step["part_of"].as_u64().map_or(0, |of| depths[of as usize] + 1);
        depths.push(depth);
        let is_dark = (0..3).all(|i| number(&step["adds"][i]) == 0.0);
        let text = |key: &str| step[key].as_str().unwrap_or_default();
        let is = text("is");
        let what = match is {
            "sample" => continue,
            "surface" => {
                let name = text("name");
                let of = match name {
                    "" => String::new(),
                    name => format!("object {} \"{name}\", ", step["object"]),
                };
                format!(
                    "meets {of}material \"{}\" after {:.3}, at {}",
                    text("material"),
                    number(&step["distance"]),
                    band(&step["position"])
                )
            }
            "ray" => format!("{}, {}, pdf {:.4}", text("way"), text("lobe"), number(&step["pdf"])),
            "glossy" => {
                format!("a lobe by {} rays and {} light samples", step["rays"], step["light_samples"])
            }
            "layer" => "one layer".to_owned(),
            "band" => format!("the band {}", band(&step["color"])),
            "roulette" => format!(
                "chance: goes on with {:.3}, drew {:.3}: {}",
                number(&step["survival"]),
                number(&step["drawn"]),
                if step["goes_on"] == true { "goes on" } else { "ends" }
            ),
            "light" if step["blocked"] == true => "a light's sample: something stands before it".to_owned(),
            "light" => {
                format!(
                    "a light's sample, pdf {:.4}, weight {:.3}",
                    number(&step["pdf"]),
                    number(&step["weight"])
                )
            }
            _ if is_dark => continue,
            other => other.to_owned(),
        };
        let drawn = step["random_numbers"].as_array().map_or_else(String::new, |numbers| {
            let all: Vec<_> = numbers.iter().map(|n| format!("{:.4}", number(n))).collect();
            format!(", drew {}", all.join(" "))
        });
        let adds = match is_dark {
            true => String::new(),
            false => format!(": adds {}", band(&step["adds"])),
        };
        lines.push(format!("{:indent$}{what}{drawn}{adds}", "", indent = 2 * depth));
    }
    lines
}

/// A picture with a path over it, enlarged so that both can be seen.
pub fn drawn_over(picture: &Map2d<[u8; 3]>, segments: &[Segment], pixel: (u32, u32)) -> Map2d<[u8; 3]> {
    let scale = DRAWN_SIDE_MIN.div_ceil(picture.width().max(picture.height()).max(1)).max(1);
    let (width, height) = (picture.width() * scale, picture.height() * scale);
    let mut drawn = Map2d::from_fn(width, height, |x, y| picture.at(x / scale, y / scale));
    let large = |[x, y]: [f32; 2]| [x * scale as f32, y * scale as f32];
    // The brightest last.
    let mut by_share: Vec<&Segment> = segments.iter().collect();
    by_share.sort_by(|a, b| a.share.total_cmp(&b.share));
    for segment in by_share {
        let color = segment.color();
        let ends = segment.ends.map(large);
        // A dark seam, so that it is seen on every ground.
        for [dx, dy] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
            line(&mut drawn, ends.map(|[x, y]| [x + dx, y + dy]), [0; 3], 0.3);
        }
        line(&mut drawn, ends, color, 0.5 + 0.5 * segment.share);
    }
    let [x, y] = large([pixel.0 as f32, pixel.1 as f32]);
    let (far, side) = (3.0, scale as f32);
    let (a, b) = ([x - far, y - far], [x + side + far, y + side + far]);
    for ends in [[a, [b[0], a[1]]], [[b[0], a[1]], b], [b, [a[0], b[1]]], [[a[0], b[1]], a]] {
        line(&mut drawn, ends, [255, 255, 255], 1.0);
    }
    drawn
}

impl Segment {
    /// What it is drawn in: what much light comes along is bright.
    pub fn color(&self) -> [u8; 3] {
        let glow = (self.share.sqrt() * 155.0) as u8;
        if self.to_light { [100 + glow, 100 + glow, 40] } else { [glow / 2, 100 + glow, 255] }
    }
}

/// A line of one pixel, as far as it lies in the picture.
fn line(picture: &mut Map2d<[u8; 3]>, [a, b]: [[f32; 2]; 2], color: [u8; 3], opacity: f32) {
    let size = [picture.width() as f32, picture.height() as f32];
    // What lies outside of the picture is no work.
    let (mut first, mut last) = (0.0_f32, 1.0_f32);
    for i in 0..2 {
        let (from, by) = (a[i], b[i] - a[i]);
        if by == 0.0 {
            if !(0.0..size[i]).contains(&from) {
                return;
            }
            continue;
        }
        let (s, t) = (-from / by, (size[i] - from) / by);
        (first, last) = (first.max(s.min(t)), last.min(s.max(t)));
    }
    if first > last || !(last - first).is_finite() {
        return;
    }
    let at = |t: f32| [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t];
    let ([x0, y0], [x1, y1]) = (at(first), at(last));
    let count = (x1 - x0).abs().max((y1 - y0).abs()).ceil().max(1.0) as usize;
    for i in 0..=count {
        let t = i as f32 / count as f32;
        let (x, y) = ((x0 + (x1 - x0) * t) as usize, (y0 + (y1 - y0) * t) as usize);
        if x < picture.width() && y < picture.height() {
            let before = picture.at(x, y);
            let mixed = std::array::from_fn(|c| {
                let (old, new) = (f32::from(before[c]), f32::from(color[c]));
                (old + (new - old) * opacity) as u8
            });
            *picture.at_mut(x, y) = mixed;
        }
    }
}
