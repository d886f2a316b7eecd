//! Why a pixel looks as it does: the chain from the input over snapshot, saliency, priority and job to the sample that
//! it shows, or the cached sample and its age.

use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal::allocation::policy::bucket_of;
use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::sampling::Lattice;
use foveal::scene::{Camera, Scene};
use foveal::splatting::{Reconstruction, SampleBatch, SplatLayer, WarpedSample};
use foveal_actors::message::{DrawnView, FrameSnapshot, SampleOrder};
use foveal_runtime::{ActorId, Delivery, Event, Observer};
use glam::Vec3;
use serde_json::{Value, json};

use super::source::{How, Source};
use super::why_light;
use super::why_notes::{Note, Noted, Notes, note};
use super::why_path::{self, Segment, Traced};
use crate::failure::Failure;

/// A delivery: actor and number.
pub(super) type At = (ActorId, u64);

/// The last frame up to this one that began with another camera than the one before, or that was the first: where it began,
/// and its number. What comes from outside stands in the recording.
fn moved(source: &Source, frame: u32) -> Option<(At, u32)> {
    let (mut last, mut moved) = (None, None);
    for begun in source.frames_begun().take_while(|begun| begun.frame <= frame) {
        let before = last.replace(begun.camera);
        if begun.frame == 0 || before.is_some_and(|before: Camera| before != begun.camera) {
            moved = Some(((source.renderer(), begun.index), begun.frame));
        }
    }
    moved
}

/// What the pixel shows.
pub(super) struct ShownPixel {
    snapshot: Arc<FrameSnapshot>,
    pub drawn: Arc<DrawnView>,
    /// Radiance of the base layer and of the splat on it.
    base: Vec3,
    splat: Vec3,
    /// How much of what is shown is the sample that lies on the pixel.
    own_share: f32,
}

/// The sample behind a splat.
pub(super) struct SampleOrigin {
    /// The batch and where it was delivered to whom it was found with; none where it came before the replay began.
    pub batch: Option<(At, Arc<SampleBatch>)>,
    /// Pixel it was traced through, in its own view.
    pixel: Option<[u16; 2]>,
    level_set: u32,
    /// Views since it was traced: 0 for a fresh one.
    pub age: u32,
}

/// The story of a pixel, in lines, and its sample's path over the picture.
///
/// # Errors
/// As those of [`explain`].
pub fn story(
    source: &Source,
    pixel: (u32, u32),
    frame: Option<u32>,
    workers: usize,
) -> Result<(Vec<String>, Vec<Segment>), Failure> {
    let Explained { document, segments, .. } = explain(source, pixel, frame, true, workers)?;
    Ok((told(&document), segments))
}

/// Why a pixel looks as it does.
pub struct Explained {
    /// The story, as a document.
    pub document: Value,
    /// The frame's picture.
    pub picture: Arc<Map2d<[u8; 3]>>,
    /// The sample's path over the picture; empty where it was not asked for, or there is none.
    pub segments: Vec<Segment>,
}

/// The story of a pixel, as a document; with `path` its sample is traced again.
///
/// # Errors
/// If there is no such pixel or frame, or the replay diverges.
pub fn explain(
    source: &Source,
    (x, y): (u32, u32),
    frame: Option<u32>,
    path: bool,
    workers: usize,
) -> Result<Explained, Failure> {
    let settings = &source.recorded.settings;
    if x >= settings.width || y >= settings.height {
        let size = format!("{} × {}", settings.width, settings.height);
        return Err(Failure::Usage(format!("no pixel {x},{y}; the picture has {size}")));
    }
    let frame = frame.unwrap_or((source.shown_in.len() as u32).saturating_sub(1));
    let until = Some(source.frame_shown(frame)?);
    let queue: Arc<SegQueue<Noted>> = Arc::default();
    let sink = Arc::clone(&queue);
    let observer: Observer = Arc::new(move |d: &Delivery<'_>| {
        if let Some(note) = note(d) {
            sink.push(Noted { at: (d.actor, d.index), cause: d.cause, note });
        }
    });
    // What a pixel shows mostly came in the last frames; samples live for so many views; a camera that stood still for long
    // shows samples of long ago: as far back as it takes.
    let max_age = settings.ageing.max_age;
    let mut how = How { threads: workers, until, observer: Some(observer), jump: true, ..How::default() };
    let (px, py) = (x as usize, y as usize);
    let moved = moved(source, frame);
    let stood = moved.map_or(0, |(_, began)| frame.saturating_sub(began) as usize);
    let mut looks = [2, stood + 2, stood + 16, stood + max_age as usize + 8].into_iter();
    let (runtime, actors, shown, found, notes) = loop {
        match looks.next() {
            Some(frames) => how.frames_before = frames,
            None => how.jump = false,
        }
        let mut notes = Notes::default();
        while queue.pop().is_some() {}
        let (mut runtime, actors) = source.run(how.clone(), |_| notes.take(&queue, max_age))?;
        let report = runtime.replay_report();
        if let Some(divergence) = report.divergence {
            return Err(Failure::Check(format!("the replay diverges: {divergence}")));
        }
        let shown = runtime.inspect(actors.renderer, |r| {
            let (snapshot, drawn) = (r.shown()?.clone(), r.drawn()?.clone());
            let (buffers, layer) = (drawn.buffers(), r.layer());
            let (base, splat) = (buffers.color.at(px, py), layer.color(px, py));
            let white = ToneMap::from(&drawn.world.scene.display).white();
            let own_share = Reconstruction::new(layer, buffers, &drawn.frame, white).own_share(px, py);
            Some(ShownPixel { snapshot, drawn, base, splat, own_share })
        });
        let Some(shown) = shown.flatten() else {
            return Err(Failure::Check("nothing was shown".into()));
        };
        let found = find(source, &notes, &shown, px, py);
        let is_diffuse = !source.recorded.corrects || shown.drawn.buffers().object.at(px, py) == 0;
        if !how.jump || notes.tell_all(&shown, found.as_ref(), is_diffuse, moved) {
            break (runtime, actors, shown, found, notes);
        }
    };
    let mut document = document(source, &notes, &shown, found.as_ref(), (px, py), moved);
    let allocator = actors.correction.map(|correction| correction.allocator);
    let insight = allocator.and_then(|allocator| runtime.inspect(allocator, |a| a.insight()));
    document["surface"] = why_light::surface(&shown.drawn, (px, py), insight.as_ref());
    let mut segments = Vec::new();
    if path {
        let traced = found.as_ref().and_then(|found| traced(&notes, found));
        document["path"] = traced.as_ref().map_or(Value::Null, Traced::document);
        segments = traced.map(|traced| traced.segments(&shown.drawn.frame)).unwrap_or_default();
    }
    Ok(Explained { document, picture: shown.snapshot.rgb8.clone(), segments })
}

/// The sample behind a splat, traced again as its job says.
fn traced(notes: &Notes, found: &SampleOrigin) -> Option<Traced> {
    let ((delivered, batch), pixel) = (found.batch.as_ref()?, found.pixel?);
    let Note::Job { job } = notes.note(notes.cause(*delivered)?)? else { return None };
    let sample = batch.pixels.iter().zip(&batch.colors).find(|(p, _)| **p == pixel).map(|(_, c)| *c)?;
    Traced::again(job, pixel, sample)
}

/// Repeats the splats of the view on a layer of its own and sees which one painted the pixel last.
fn find(source: &Source, notes: &Notes, shown: &ShownPixel, x: usize, y: usize) -> Option<SampleOrigin> {
    let settings = &source.recorded.settings;
    let (width, height) = (settings.width as usize, settings.height as usize);
    let mut layer = SplatLayer::new(width, height, settings.k_max, settings.footprint);
    let buffers = shown.drawn.buffers();
    let view = shown.drawn.view.0;
    let mut painter: Option<At> = None;
    let mut last_source = 0;
    let renderer = source.renderer();
    for (at, (_, note)) in notes.all.range((renderer, 0)..=(renderer, u64::MAX)) {
        match note {
            Note::Aged { view: of, samples } if *of == view => {
                layer.splat_warped(samples, &buffers.object, &buffers.depth);
                if layer.is_covered(x, y) && layer.source(x, y) == 0 {
                    painter = Some(*at);
                    last_source = 0;
                }
            }
            Note::Traced { batch } if batch.view == view => {
                // Another number than the painter's tells who painted.
                let own = if last_source == 1 { 2 } else { 1 };
                layer.splat_fresh(batch, &buffers.object, own);
                if layer.source(x, y) == own {
                    painter = Some(*at);
                    last_source = own;
                }
            }
            _ => {}
        }
    }
    let color = layer.color(x, y);
    let same = |c: &Vec3| c.to_array().map(f32::to_bits) == color.to_array().map(f32::to_bits);
    let (level_set, _) = layer.shown_level(x, y)?;
    match notes.note(painter?)? {
        Note::Traced { batch } => {
            let painted = |p: &[u16; 2]| {
                let (dx, dy) = (x as i32 - i32::from(p[0]), y as i32 - i32::from(p[1]));
                let reach = Lattice::square_side(batch.k);
                dx.abs() <= reach && dy.abs() <= reach
            };
            let mut pairs = batch.pixels.iter().zip(&batch.colors).rev();
            let pixel = pairs.find(|(p, c)| same(c) && painted(p)).map(|(p, _)| *p);
            Some(SampleOrigin { batch: Some((painter?, batch.clone())), pixel, level_set, age: 0 })
        }
        Note::Aged { samples, .. } => {
            let covers = |s: &&WarpedSample| {
                let reach = u32::from(s.half_side);
                u32::from(s.x).abs_diff(x as u32) <= reach && u32::from(s.y).abs_diff(y as u32) <= reach
            };
            let sample = samples.iter().rev().filter(covers).find(|s| same(&s.color))?;
            let age = u32::from(sample.age);
            let of = view.wrapping_sub(age);
            let kept = notes.all.iter().find_map(|(at, (_, note))| match note {
                Note::Kept { batch }
                    if batch.view == of
                        && batch.object == sample.object
                        && batch.k == u32::from(sample.k)
                        && batch.colors.iter().any(same) =>
                {
                    Some((*at, batch.clone()))
                }
                _ => None,
            });
            let pixel = kept.as_ref().and_then(|(_, batch)| {
                let mut pairs = batch.pixels.iter().zip(&batch.colors);
                pairs.find(|(_, c)| same(c)).map(|(p, _)| *p)
            });
            Some(SampleOrigin { batch: kept, pixel, level_set: u32::from(sample.k), age })
        }
        _ => None,
    }
}

/// What is said of a sample that does not make up all that its pixel shows.
fn mixed(own_share: f32) -> String {
    match own_share {
        1.0.. => String::new(),
        share if share > 0.0 => {
            format!(", {:.0} % of what is shown; the rest is of those around", share * 100.0)
        }
        _ => ", near the pixel; the colour is interpolated from it and its neighbours".to_owned(),
    }
}

fn views(count: u32) -> String {
    if count == 1 { "1 view".to_owned() } else { format!("{count} views") }
}

fn object_name(scene: &Scene, object: u32) -> String {
    scene.objects.get(object as usize).map_or_else(String::new, |o| o.name.clone())
}

/// One link of the chain.
fn link(source: &Source, step: &str, at: Option<At>, text: String) -> Value {
    json!({"step": step, "at": at.map(|at| source.at(at)), "text": text})
}

fn document(
    source: &Source,
    notes: &Notes,
    shown: &ShownPixel,
    found: Option<&SampleOrigin>,
    (x, y): (usize, usize),
    moved: Option<(At, u32)>,
) -> Value {
    let drawn = &shown.drawn;
    let object = drawn.buffers().object.at(x, y);
    let mut chain = Vec::new();
    let what = match found {
        None if object == 0 => "base layer: a diffuse surface, which needs no sample".to_owned(),
        None if shown.splat != Vec3::ZERO => {
            "its object's environment map: no sample has come yet".to_owned()
        }
        None => "base layer: no sample has come yet".to_owned(),
        Some(found) if found.age == 0 => {
            format!("a fresh sample of level set {}{}", found.level_set, mixed(shown.own_share))
        }
        Some(found) => {
            let of = mixed(shown.own_share);
            format!("a cached sample of level set {}, {} old{of}", found.level_set, views(found.age))
        }
    };
    let view = drawn.view.0 - found.map_or(0, |f| f.age.min(drawn.view.0));
    let began = notes.all.iter().find(|(_, (_, note))| matches!(note, Note::Drawn { view: v } if *v == view));
    // The newest view may not yet have come to the allocator, or have come long before.
    let newest = moved.filter(|_| view == drawn.view.0);
    let input = began.and_then(|(_, (cause, _))| *cause).or(newest.map(|(at, _)| at));
    if let Some(at) = input {
        let noted = match notes.note(at) {
            Some(Note::Began { frame, .. }) => Some(*frame),
            _ => newest.filter(|(of, _)| *of == at).map(|(_, frame)| frame),
        };
        let frame = match noted {
            Some(frame) => format!("frame {frame} began with a camera that had moved: view {view}"),
            None => format!("view {view} began"),
        };
        chain.push(link(source, "input", Some(at), frame));
    }
    light(source, notes, shown, &mut chain);
    if let Some(found) = found {
        samples(source, notes, shown, found, &mut chain);
    }
    let rgb = shown.snapshot.rgb8.at(x, y);
    json!({
        "schema": "foveal.why/1",
        "frame": shown.snapshot.index.0,
        "pixel": [x, y],
        "view": drawn.view.0,
        "object": object,
        "name": object_name(&drawn.world.scene, object),
        "shows": what,
        "age": found.map(|f| f.age),
        "own_share": found.map(|_| f64::from((shown.own_share * 1000.0).round()) / 1000.0),
        "rgb": rgb,
        "base": shown.base.to_array(),
        "splat": shown.splat.to_array(),
        "chain": chain,
    })
}

/// The link to the turn of the illuminator whose map the view shows, if it came since the notes began.
fn light(source: &Source, notes: &Notes, shown: &ShownPixel, chain: &mut Vec<Value>) {
    let Some(stored) = shown.drawn.world.illumination.stored() else { return };
    let rounds = stored.summary.rounds;
    let came =
        notes.all.iter().rev().find(|(_, (_, note))| matches!(note, Note::Lit { rounds: r } if *r == rounds));
    if let Some((at, (cause, _))) = came {
        let made = cause.map_or_else(String::new, |cause| format!(", made in {}", source.at(cause)));
        chain.push(link(source, "light", Some(*at), format!("the map of round {rounds} came{made}")));
    } else if let Some(at) = newest_map(source, shown) {
        chain.push(link(
            source,
            "light",
            Some(at),
            "the newest map by then came from the illuminator".into(),
        ));
    }
}

/// The last word of the illuminator before the frame was shown, as the recording has it.
fn newest_map(source: &Source, shown: &ShownPixel) -> Option<At> {
    let (renderer, illuminator) = (source.renderer(), source.trace.find("illuminator")?);
    let end = *source.shown_in.get(shown.snapshot.index.0 as usize)?;
    let told = source.trace.events(renderer).filter_map(|event| match event {
        Event::Delivered { index, from, .. } if from == illuminator => Some(index),
        _ => None,
    });
    told.take_while(|index| *index <= end).last().map(|index| (renderer, index))
}

/// The links from what the analyzer saw to the sample.
fn samples(source: &Source, notes: &Notes, shown: &ShownPixel, found: &SampleOrigin, chain: &mut Vec<Value>) {
    let Some((delivered, batch)) = &found.batch else {
        chain.push(link(source, "sample", None, "traced before this replay began".into()));
        return;
    };
    let job_at = notes.cause(*delivered);
    let job = job_at.and_then(|at| notes.note(at));
    if let (Some(job_at), Some(Note::Job { job })) = (job_at, job) {
        let SampleOrder { order, priority, attention, .. } = job;
        let pushed = notes.cause(job_at);
        if let Some((allocator, index)) = pushed {
            let ranks = notes.all.range((allocator, 0)..=(allocator, index)).rev();
            let ranked = ranks.filter_map(|(at, (cause, note))| match note {
                Note::Ranked { saliency } => Some((*at, *cause, saliency)),
                _ => None,
            });
            if let Some((at, cause, saliency)) = ranked.into_iter().next() {
                if let Some(Note::Looked { frame }) = cause.and_then(|at| notes.note(at)) {
                    let text = format!("the analyzer looked at frame {frame}");
                    chain.push(link(source, "snapshot", cause, text));
                }
                let of = saliency.get(order.object as usize).copied().unwrap_or(0.0);
                let rank = saliency.iter().skip(1).filter(|s| **s > of).count() + 1;
                let text = format!("{of:.4} of object {}, rank {rank}", order.object);
                chain.push(link(source, "saliency", Some(at), text));
            } else {
                chain.push(link(source, "saliency", None, "none was known yet".into()));
            }
            let woke = match notes.note((allocator, index)) {
                Some(Note::Woke { kind }) => kind,
                Some(Note::Drawn { .. }) => "ViewDrawn",
                Some(Note::Ranked { .. }) => "ObjectsRanked",
                _ => "a message",
            };
            let bucket = bucket_of(*priority);
            let text =
                format!("attention {attention:.4}, priority {priority:.4}, bucket {bucket}, given on {woke}");
            chain.push(link(source, "priority", pushed, text));
        }
        let rect = &order.rect;
        let text = format!(
            "{} samples of object {}, level {}, pixels [{}, {}) × [{}, {})",
            order.count, order.object, order.level, rect.x0, rect.x1, rect.y0, rect.y1
        );
        chain.push(link(source, "job", Some(job_at), text));
    }
    let place = match found.pixel {
        Some([x, y]) => format!("traced through pixel {x},{y} of view {}", batch.view),
        None => format!("traced in view {}", batch.view),
    };
    let told = if found.age == 0 { "" } else { ", kept by the cache ager" };
    chain.push(link(source, "sample", Some(*delivered), format!("{place}{told}")));
    if found.age > 0 {
        let aged =
            notes.all.iter().rev().find(
                |(_, (_, note))| matches!(note, Note::Aged { view, .. } if *view == shown.drawn.view.0),
            );
        let text = format!("warped into view {}, {} old", shown.drawn.view.0, views(found.age));
        chain.push(link(source, "cache", aged.map(|(at, _)| *at), text));
    }
    let at = (source.renderer(), source.shown_in[shown.snapshot.index.0 as usize]);
    if let Some(Note::Shown { frame }) = notes.note(at) {
        chain.push(link(source, "pixel", Some(at), format!("shown in frame {frame}")));
    }
}

/// The same in lines.
pub fn told(d: &Value) -> Vec<String> {
    let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    let mut lines = vec![
        format!(
            "frame {}, pixel {},{}: object {} \"{}\", rgb {} {} {}",
            d["frame"],
            d["pixel"][0],
            d["pixel"][1],
            d["object"],
            text(&d["name"]),
            d["rgb"][0],
            d["rgb"][1],
            d["rgb"][2],
        ),
        format!("shows     {}", text(&d["shows"])),
    ];
    for link in d["chain"].as_array().into_iter().flatten() {
        let line = format!("{:<9} {:<15} {}", text(&link["step"]), text(&link["at"]), text(&link["text"]));
        lines.push(line.trim_end().to_owned());
    }
    lines.extend(why_light::told(&d["surface"]));
    match &d["path"] {
        // Not asked for.
        Value::Null if d.get("path").is_none() => {}
        Value::Null => lines.push("path      none: no sample was traced for this pixel".to_owned()),
        path => lines.extend(why_path::told(path)),
    }
    lines
}
