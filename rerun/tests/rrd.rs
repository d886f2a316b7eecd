//! A file is read back by the format's own reader, and holds what a replay shows.

use std::collections::BTreeMap;
use std::path::Path;

use foveal_engine::recording::Elsewhere;
use foveal_engine::replay::{How, Source};
use foveal_rerun::{Written, write};
use re_chunk::{Chunk, ComponentIdentifier, TimelineName};
use re_log_encoding::rrd::DecoderApp;
use re_log_types::LogMsg;
use re_sdk_types::archetypes::{EncodedImage, Pinhole, Scalars, SegmentationImage, Transform3D};
use re_sdk_types::components::{Blob, ImageBuffer, Resolution, Scalar, Translation3D};

fn kept(name: &str) -> Source {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let scene = Path::new("scenes").join(name).join(name).with_extension("toml");
    let elsewhere = Elsewhere { scene: Some(root.join(scene)), ..Elsewhere::default() };
    let file = root.join("traces").join(name).with_extension("fvl");
    Source::open(&file, &elsewhere, true, &()).expect("a walk")
}

fn written(source: &Source) -> (Written, Vec<u8>) {
    let mut bytes = Vec::new();
    let written = write(source, &mut bytes).expect("it can be written");
    (written, bytes)
}

/// All rows, by entity.
fn read(bytes: &[u8]) -> BTreeMap<String, Vec<Chunk>> {
    let mut all = BTreeMap::<String, Vec<Chunk>>::new();
    for message in DecoderApp::decode_lazy(bytes) {
        if let LogMsg::ArrowMsg(_, message) = message.expect("a message") {
            let chunk = Chunk::from_arrow_msg(&message).expect("a chunk");
            all.entry(chunk.entity_path().to_string()).or_default().push(chunk);
        }
    }
    all
}

/// What stands in a column, by the number of its frame.
fn column<C: re_sdk_types::Component>(chunks: &[Chunk], of: ComponentIdentifier) -> BTreeMap<i64, C> {
    let mut found = BTreeMap::new();
    for chunk in chunks {
        let times = chunk.timelines()[&TimelineName::from_static_str("frame")].times_raw();
        for (row, frame) in times.iter().enumerate() {
            let mut value = chunk.component_batch::<C>(of, row).expect("a column").expect("values");
            assert!(found.insert(*frame, value.remove(0)).is_none(), "frame {frame} stands there twice");
        }
    }
    found
}

#[test]
fn a_file_holds_each_frame_as_it_was_shown() {
    let source = kept("box");
    let (written, bytes) = written(&source);
    let frames = source.shown_in.len();
    assert_eq!(written.frames as usize, frames);
    let all = read(&bytes);

    let pictures = column::<Blob>(&all["/world/camera/picture"], EncodedImage::descriptor_blob().component);
    let ids = column::<ImageBuffer>(
        &all["/world/camera/objects"],
        SegmentationImage::descriptor_buffer().component,
    );
    let cameras = &all["/world/camera"];
    let eyes = column::<Translation3D>(cameras, Transform3D::descriptor_translation().component);
    let sizes = column::<Resolution>(cameras, Pinhole::descriptor_resolution().component);
    assert_eq!([pictures.len(), eyes.len(), sizes.len()], [frames; 3]);
    assert_eq!(ids.len(), written.views as usize);

    let mut views = 0;
    for frame in 0..frames as u32 {
        let until = Some(source.frame_shown(frame).expect("a frame"));
        let (runtime, walk) = source.run(How { until, ..How::default() }, |_| ()).expect("a replay");
        let shown = runtime.inspect(walk.renderer, |r| r.shown().cloned()).flatten().expect("a picture");
        let at = i64::from(frame);
        let png = image::load_from_memory(&pictures[&at].0).expect("a PNG").into_rgb8();
        assert_eq!(png.as_raw(), shown.rgb8.data().as_flattened(), "frame {frame}");
        assert_eq!(eyes[&at].0.0, shown.drawn.frame.eye.to_array());
        assert_eq!(sizes[&at].0.0, shown.drawn.frame.size.map(|side| side as f32));
        if let Some(ids) = ids.get(&at) {
            views += 1;
            let ids: Vec<u32> =
                ids.0.as_chunks().0.iter().map(|id| u32::from(u16::from_le_bytes(*id))).collect();
            assert_eq!(ids, shown.drawn.buffers().object.data());
        }
    }
    assert_eq!(views, written.views);
}

#[test]
fn numbers_of_actors_are_those_of_the_state() {
    let source = kept("gallery");
    let (written, bytes) = written(&source);
    let all = read(&bytes);
    let of = Scalars::descriptor_scalars().component;
    assert_eq!(all.keys().filter(|path| path.starts_with("/actors/")).count(), written.numbers as usize);
    let views = column::<Scalar>(&all["/actors/renderer/view"], of);
    // They stand where they change.
    let numbers: Vec<f64> = views.values().map(|number| number.0.0).collect();
    assert!(numbers.len() > 1 && numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
    assert!(all.contains_key("/actors/allocator/begun"), "{:?}", all.keys());
}

/// Both time lines grow, and nothing depends on when the file was made but how its index is laid.
#[test]
fn the_same_recording_gives_the_same_messages() {
    let source = kept("box");
    let (_, bytes) = written(&source);
    let messages = |bytes: &[u8]| -> Vec<LogMsg> {
        DecoderApp::decode_lazy(bytes).map(|message| message.expect("a message")).collect()
    };
    assert!(messages(&bytes) == messages(&written(&source).1));
    let all = read(&bytes);
    let times = |line: &'static str| -> Vec<i64> {
        let chunks = &all["/world/camera/picture"];
        chunks
            .iter()
            .flat_map(|c| c.timelines()[&TimelineName::from_static_str(line)].times_raw().to_vec())
            .collect()
    };
    let frames: Vec<i64> = (0..source.shown_in.len() as i64).collect();
    assert_eq!(times("frame"), frames);
    let walk = times("walk");
    assert_eq!(walk.len(), frames.len());
    assert!(walk.is_sorted_by(|a, b| a < b) && walk[0] > 0, "{walk:?}");
}
