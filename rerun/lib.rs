//! A recorded walk as a file for the viewer of rerun (`.rrd`): replayed once, frame by frame.
//!
//! | entity | what |
//! | --- | --- |
//! | `world/camera` | where it stands in each frame: a transform and a pinhole |
//! | `world/camera/picture` | each frame as it was shown, as PNG |
//! | `world/camera/objects` | each view's object ids, with the objects' names at `world` |
//! | `actors/NAME/…` | the numbers in each actor's state, where they change |
//!
//! Two time lines: `frame`, its number, and `walk`, the time since the walk began as its frames were meant to take. The same
//! recording gives the same messages; the index of them at the end is laid as the encoder likes.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::Write;

use foveal::scene::Scene;
use foveal_engine::Failure;
use foveal_engine::files::png_bytes;
use foveal_engine::foveal_actors::message::FrameSnapshot;
use foveal_engine::interrupt::interrupted;
use foveal_engine::recording::Parent;
use foveal_engine::replay::{How, Source};
use foveal_runtime::{ActorId, Content, Runtime};
use re_chunk::{Chunk, ChunkId, EntityPath, RowId, TimePoint, Timeline};
use re_log_encoding::rrd::{Encoder, EncodingOptions};
use re_log_types::external::re_tuid::Tuid;
use re_log_types::{EntityPathPart, LogMsg, SetStoreInfo, StoreId, StoreInfo, StoreSource};
use re_sdk_types::AsComponents;
use re_sdk_types::archetypes::{
    AnnotationContext, EncodedImage, Pinhole, Scalars, SegmentationImage, Transform3D, ViewCoordinates,
};
use re_sdk_types::components::{ImageFormat, MediaType, ViewCoordinates as Axes};
use re_sdk_types::datatypes::ChannelDatatype;

/// Names on the way to a number in an actor's state, at most.
const DEPTH: usize = 3;
/// Numbers of one actor, at most.
const NUMBERS: usize = 256;

/// What a file holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Frames, each with a picture and a camera.
    pub frames: u32,
    /// Views, each with its object ids.
    pub views: u32,
    /// Numbers of actors.
    pub numbers: u32,
}

/// What cannot be encoded or written.
fn failed(e: impl Display) -> Failure {
    Failure::Environment(format!("the .rrd file: {e}"))
}

/// Replays a recording and writes it.
///
/// # Errors
/// If the replay diverges, is interrupted, or the file cannot be written.
pub fn write(source: &Source, out: impl Write) -> Result<Written, Failure> {
    let mut file = File::begin(source, out)?;
    file.of_scene(&source.world().scene)?;
    let times = times(source);
    let actors: Vec<(ActorId, &str)> = (0_u32..)
        .zip(&source.trace.header().nodes)
        .filter(|(_, node)| node.class.is_some())
        .map(|(number, node)| (ActorId(number), node.name.as_str()))
        .collect();
    let mut numbers = Numbers::default();
    let mut written = Written::default();
    let mut view = None;
    // One delivery at a time: so where all others stand when a frame is shown is the same each time.
    let (mut runtime, walk) = source.system(How::default())?;
    while runtime.step(None).is_some() {
        if interrupted() {
            return Err(Failure::Interrupted("interrupted while replaying".into()));
        }
        if let Some(divergence) = runtime.diverged().then(|| runtime.replay_report().divergence).flatten() {
            return Err(Failure::Check(format!("the replay diverges: {divergence}")));
        }
        let shown = runtime.inspect(walk.renderer, |renderer| renderer.shown().cloned()).flatten();
        let Some(shown) = shown.filter(|shown| shown.index.0 >= written.frames) else { continue };
        let now = Now { frame: shown.index.0, seconds: times.get(&shown.index.0).copied() };
        file.of_frame(&now, &shown)?;
        if view.replace(shown.drawn.view) != Some(shown.drawn.view) {
            file.of_view(&now, &shown)?;
            written.views += 1;
        }
        numbers.look(&runtime, &actors, &now);
        written.frames = shown.index.0 + 1;
    }
    written.numbers = numbers.all.len() as u32;
    file.of_numbers(&numbers)?;
    file.end()?;
    Ok(written)
}

/// When each frame was to be shown, seconds since the walk began.
fn times(source: &Source) -> BTreeMap<u32, f64> {
    let mut times = BTreeMap::new();
    let mut seconds = 0.0;
    for begun in source.frames_begun() {
        seconds += f64::from(begun.time);
        times.insert(begun.frame, seconds);
    }
    times
}

/// A place on both time lines.
#[derive(Clone, Copy, Debug)]
struct Now {
    frame: u32,
    seconds: Option<f64>,
}

impl Now {
    fn point(&self) -> TimePoint {
        let point = TimePoint::default().with(Timeline::new_sequence("frame"), i64::from(self.frame));
        match self.seconds {
            Some(seconds) => point.with(Timeline::new_duration("walk"), (seconds * 1e9).round() as i64),
            None => point,
        }
    }
}

/// The numbers that actors tell of their state, by actor and path, where they change.
#[derive(Default)]
struct Numbers {
    all: BTreeMap<(String, Vec<String>), Vec<(Now, f64)>>,
}

impl Numbers {
    fn look(&mut self, runtime: &Runtime, actors: &[(ActorId, &str)], now: &Now) {
        for (actor, name) in actors {
            let mut found = Vec::new();
            numbers_of(&runtime.content(*actor).unwrap_or_default(), &mut Vec::new(), &mut found);
            for (path, number) in found.into_iter().take(NUMBERS) {
                let row = self.all.entry(((*name).to_owned(), path)).or_default();
                if row.last().is_none_or(|(_, last)| last.to_bits() != number.to_bits()) {
                    row.push((*now, number));
                }
            }
        }
    }
}

/// Numbers and flags in a state, with the names on the way to them.
fn numbers_of(state: &Content, path: &mut Vec<String>, found: &mut Vec<(Vec<String>, f64)>) {
    let number = match state {
        Content::Flag(flag) => Some(f64::from(u8::from(*flag))),
        // How long a list is says little.
        Content::List(_) => None,
        other => other.number(),
    };
    found.extend(number.map(|number| (path.clone(), number)));
    if let (Content::Fields { fields, .. }, true) = (state, path.len() < DEPTH) {
        for (name, value) in fields {
            path.push(name.clone().into_owned());
            numbers_of(value, path, found);
            path.pop();
        }
    }
}

/// The file as it grows. Its ids are counted, so that nothing in it depends on when it was made.
struct File<W: Write> {
    encoder: Encoder<W>,
    store: StoreId,
    ids: u64,
}

impl<W: Write> File<W> {
    fn begin(source: &Source, out: W) -> Result<Self, Failure> {
        let store = StoreId::recording("foveal", Parent::hash_of(&source.path));
        let info = StoreInfo::new(store.clone(), StoreSource::Other("foveal".into()));
        let version = info.store_version.ok_or_else(|| failed("a format without a version"))?;
        let encoder =
            Encoder::new_eager(version, EncodingOptions::PROTOBUF_COMPRESSED, out).map_err(failed)?;
        let mut file = Self { encoder, store, ids: 0 };
        let row_id = file.id();
        file.append(&LogMsg::SetStoreInfo(SetStoreInfo { row_id, info }))?;
        Ok(file)
    }

    fn id(&mut self) -> Tuid {
        self.ids += 1;
        Tuid::from_nanos_and_inc(self.ids, 0)
    }

    fn append(&mut self, message: &LogMsg) -> Result<(), Failure> {
        self.encoder.append(message).map(drop).map_err(failed)
    }

    /// Rows of one entity, as a chunk.
    fn rows<'a>(
        &mut self,
        entity: EntityPath,
        rows: impl IntoIterator<Item = (TimePoint, Vec<&'a dyn AsComponents>)>,
    ) -> Result<(), Failure> {
        let mut chunk = Chunk::builder_with_id(ChunkId::from_tuid(self.id()), entity);
        for (time, parts) in rows {
            let batches = parts.into_iter().flat_map(AsComponents::as_serialized_batches);
            chunk = chunk.with_serialized_batches(RowId::from_tuid(self.id()), time, batches);
        }
        let message = chunk.build().and_then(|chunk| chunk.to_arrow_msg()).map_err(failed)?;
        let store = self.store.clone();
        self.append(&LogMsg::ArrowMsg(store, message))
    }

    /// What holds all the time: which way is up, and what objects are called.
    fn of_scene(&mut self, scene: &Scene) -> Result<(), Failure> {
        let upright = scene.up.z.abs() > scene.up.y.abs();
        let axes = if upright { Axes::RIGHT_HAND_Z_UP } else { Axes::RIGHT_HAND_Y_UP };
        let axes = ViewCoordinates::new(axes);
        let names = AnnotationContext::new(
            (0_u16..=u16::MAX).zip(&scene.objects).map(|(id, object)| (id, object.name.as_str())),
        );
        self.rows("world".into(), [(TimePoint::STATIC, vec![&axes as &dyn AsComponents, &names])])
    }

    fn of_frame(&mut self, now: &Now, shown: &FrameSnapshot) -> Result<(), Failure> {
        let camera = &shown.drawn.frame;
        let (right, up, [width, height]) = (camera.right, camera.up, camera.size.map(|side| side as f32));
        // Columns: right, down, forward.
        let axes = [right.normalize(), -up.normalize(), camera.forward].map(|axis| axis.to_array());
        let place = Transform3D::from_translation_mat3x3(camera.eye.to_array(), axes);
        // The image plane at distance 1 is twice these vectors wide and high.
        let focal = [0.5 * width / right.length(), 0.5 * height / up.length()];
        let pinhole = Pinhole::from_focal_length_and_resolution(focal, [width, height]);
        let rows = [(now.point(), vec![&place as &dyn AsComponents, &pinhole])];
        self.rows("world/camera".into(), rows)?;
        let pixels = &shown.rgb8;
        let png = png_bytes(pixels.width() as u32, pixels.height() as u32, pixels.data().as_flattened())?;
        let picture = EncodedImage::new(png).with_media_type(MediaType::png());
        self.rows("world/camera/picture".into(), [(now.point(), vec![&picture as &dyn AsComponents])])
    }

    fn of_view(&mut self, now: &Now, shown: &FrameSnapshot) -> Result<(), Failure> {
        let ids = &shown.drawn.buffers().object;
        let size = [ids.width() as u32, ids.height() as u32];
        // Classes have 16 bits.
        let bytes: Vec<u8> =
            ids.data().iter().flat_map(|id| u16::try_from(*id).unwrap_or(u16::MAX).to_le_bytes()).collect();
        let objects = SegmentationImage::new(bytes, ImageFormat::segmentation(size, ChannelDatatype::U16));
        self.rows("world/camera/objects".into(), [(now.point(), vec![&objects as &dyn AsComponents])])
    }

    fn of_numbers(&mut self, numbers: &Numbers) -> Result<(), Failure> {
        for ((actor, path), rows) in &numbers.all {
            let parts = ["actors", actor].into_iter().chain(path.iter().map(String::as_str));
            let entity = EntityPath::new(parts.map(EntityPathPart::new).collect());
            let values: Vec<_> = rows.iter().map(|(now, number)| (now, Scalars::single(*number))).collect();
            let rows = values.iter().map(|(now, value)| (now.point(), vec![value as &dyn AsComponents]));
            self.rows(entity, rows)?;
        }
        Ok(())
    }

    fn end(mut self) -> Result<(), Failure> {
        self.encoder.finish().map_err(failed)?;
        self.encoder.into_inner().map_err(failed)?.flush().map_err(failed)
    }
}
