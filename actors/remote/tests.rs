//! Walks with guests on threads of this process, over loopback: a view converges to the bits of a walk without guests, and
//! its recording replays without them. What stands at the door is asked without a walk.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use foveal::rng::hash;
use foveal::splatting::supersampling::Supersampling;
use foveal_actors::station::wire::{FromGuest, PROTOCOL, Refusal, ToGuest};
use foveal_actors::station::{Found, Heard, bits};
use foveal_engine::opened::{self, Opened};
use foveal_engine::recording::Elsewhere;
use foveal_engine::replay::{How, Source};
use foveal_engine::{Engine, Light, Options, Recording, Settings, Standing};

use crate::door::{Door, Effect, Hall, Letting};
use crate::guest::{self, Done, End, Host, Progress};
use crate::key::{Invitation, Key};
use crate::link::{self, Event};
use crate::package::{Manifest, Package};
use crate::program;

pub(super) const WAIT: Duration = Duration::from_secs(120);

pub(super) fn scene() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/box/box.toml")
}

pub(super) fn opened() -> Opened {
    let light = Light { quick: true, ..Light::default() };
    opened::open(&scene(), &light, &()).expect("a scene")
}

pub(super) fn settings(stations: u32) -> Settings {
    Settings { stations, samples_per_job: 64, ..Settings::new(96, 72, 1) }
}

/// The same, which refines what has converged.
pub(super) fn refining(settings: Settings) -> Settings {
    Settings { supersampling: Some(Supersampling { noise: 0.02, max_samples: 12 }), ..settings }
}

/// Frames of a still view until it has converged, or been refined where that is wanted; its picture.
fn converged(engine: &mut Engine) -> Vec<u8> {
    let refines = engine.settings().supersampling.is_some();
    let end = if refines { Standing::Refined } else { Standing::Converged };
    let camera = engine.opened().world.scene.cameras[0].camera;
    let began = Instant::now();
    loop {
        let frame = engine.frame(&camera, Duration::from_millis(20)).expect("a frame");
        if frame.standing == end {
            return frame.snapshot.rgb8.data().as_flattened().to_vec();
        }
        assert!(began.elapsed() < WAIT, "it does not converge");
    }
}

pub(super) fn local(opened: &Opened) -> Vec<u8> {
    still(opened, settings(0))
}

/// What a walk without guests shows in the end.
pub(super) fn still(opened: &Opened, settings: Settings) -> Vec<u8> {
    let mut engine = Engine::start(opened.clone(), Options::new(settings)).expect("actors");
    converged(&mut engine)
}

/// A recording replays to its end; one of a walk with liars in it may also stop, at the station that believed one before it
/// was found out: it has the hash of what was sent, and the scene says otherwise.
pub(super) fn replays(recording: &Path, with_liars: bool) {
    let source = Source::open(recording, &Elsewhere::default(), true, &()).expect("a recording");
    let (mut runtime, _) = source.run(How { threads: 2, ..How::default() }, |_| {}).expect("replays");
    let report = runtime.replay_report();
    match &report.divergence {
        None => assert!(report.complete, "{report:?}"),
        Some(at) => assert!(with_liars && at.name.starts_with("station") && at.kind == "Done", "{report:?}"),
    }
}

/// What a guest of this program says first.
pub(super) fn hello(cores: u16, name: String) -> FromGuest {
    FromGuest::Hello {
        protocol: PROTOCOL,
        program: program(),
        bits: bits::probe(),
        cores,
        name,
        memory: None,
    }
}

struct Nobody(Arc<AtomicBool>);

impl Host for Nobody {
    fn leaves(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn progress(&mut self, _: Progress) {}
}

pub(super) fn guest(
    invitation: &Invitation,
    stock: &Path,
    leaves: &Arc<AtomicBool>,
) -> std::thread::JoinHandle<(End, Done)> {
    let (invitation, leaves) = (invitation.clone(), Nobody(Arc::clone(leaves)));
    let stock = stock.to_owned();
    let stay = move || {
        let (mut leaves, mut done) = (leaves, Done::default());
        let mut link = link::connect(&invitation).expect("somebody answers");
        let name = "a test".into();
        let options = guest::Options {
            cores: 1,
            stock,
            stock_bytes_max: 1 << 30,
            name,
            memory_max: None,
            bits: bits::probe(),
        };
        let end = guest::stay(&mut *link, &options, &mut leaves, &mut done).expect("a stay");
        (end, done)
    };
    std::thread::spawn(stay)
}

#[test]
fn a_walk_with_guests_shows_the_bits_of_one_without() {
    walks_with_guests("tcp/127.0.0.1:0");
}

#[test]
fn a_walk_with_guests_over_quic_shows_the_bits_of_one_without() {
    walks_with_guests("quic/127.0.0.1:0");
}

/// Two guests over loopback, one of which leaves: the picture of a walk without them, and a recording that replays.
fn walks_with_guests(address: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    let (opened, recording) = (opened(), folder.path().join("guests.fvlog"));
    let expected = local(&opened);
    let package = Package::of(&opened).expect("a package");
    let settings = settings(3);
    // What is found is recorded, or traced again in replay.
    let letting = Letting { payloads: address.starts_with("quic"), ..Letting::default() };
    let door = Door::open(address, Key::new().unwrap(), package, settings.k_max, 3, letting).expect("a door");
    let options = Options {
        outlets: Some(door.outlets()),
        recording: Some(Recording::file(&recording, "test")),
        ..Options::new(settings)
    };
    let mut engine = Engine::start(opened, options).expect("actors");
    door.attach(engine.station_inputs());
    let leaves = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
    let stock = folder.path().join("stock");
    let guests = [&leaves[0], &leaves[1]].map(|leaves| guest(door.invitation(), &stock, leaves));
    let began = Instant::now();
    while door.serving() < 2 {
        assert!(began.elapsed() < WAIT, "guests do not come");
        std::thread::sleep(Duration::from_millis(5));
    }
    let scene = engine.opened().world.scene.clone();
    for round in 0..6 {
        // Another view each time, until enough came from elsewhere.
        let mut camera = scene.cameras[round % 2].camera;
        camera.eye.x += 0.01 * round as f32;
        for _ in 0..4 {
            engine.frame(&camera, Duration::from_millis(40)).expect("a frame");
        }
    }
    leaves[0].store(true, Ordering::Relaxed);
    let picture = converged(&mut engine);
    engine.finish(Duration::from_secs(20));
    let stations = engine.stations();
    assert!(picture == expected, "another picture with guests: {stations:?}");
    assert!(stations.iter().all(|station| station.counts.banned == 0), "{stations:?}");
    let remote: u64 = stations.iter().map(|station| station.counts.samples).sum();
    assert!(remote > 1000, "{remote} samples from guests, {stations:?}");
    drop(engine);
    drop(door);
    let [first, second] = guests.map(|guest| guest.join().expect("no panic"));
    assert_eq!((first.0, second.0), (End::Left, End::Farewell));
    assert!(first.1.samples + second.1.samples >= remote);
    replays(&recording, false);
}

/// What a recording has of an answer: which job, how long it took, how many colours, and their hash.
#[test]
fn an_answer_takes_twenty_bytes_of_a_recording() {
    let of = |jobs: u64| {
        let found = |i: u64| Found {
            lease: 40_000 + i,
            micros: 2_000 + i as u32,
            count: Some(256),
            hash: hash(7, i, 0),
            body: None,
        };
        let heard = Heard::Done { incarnation: 3, salt: u64::MAX, jobs: (0..jobs).map(found).collect() };
        let bytes = postcard::to_stdvec(&heard).expect("it is recorded").len();
        bytes as f32 / jobs as f32
    };
    println!("{} B where one comes alone, {} B a job of eight", of(1), of(8));
    assert!(of(8) <= 20.0, "{} B a job", of(8));
}

/// A thousand guests come and go one after the other, some with jobs that they never do: who is gone is known at once, and
/// the view converges to the bits of a walk without them.
#[test]
fn a_thousand_guests_that_come_and_go_change_no_bit() {
    let opened = opened();
    let expected = local(&opened);
    let package = Package::of(&opened).expect("a package");
    let settings = settings(1);
    let (key, letting) = (Key::new().unwrap(), Letting::default());
    let door = Door::open("tcp/127.0.0.1:0", key, package, settings.k_max, 1, letting).expect("a door");
    let options = Options { outlets: Some(door.outlets()), ..Options::new(settings) };
    let mut engine = Engine::start(opened, options).expect("actors");
    door.attach(engine.station_inputs());
    let scene = engine.opened().world.scene.clone();
    let hello = hello(1, "a passer-by".into());
    let serves = |guests: u32| {
        let began = Instant::now();
        while door.serving() != guests {
            assert!(began.elapsed() < WAIT, "{guests} guests are not there");
            std::thread::sleep(Duration::from_micros(100));
        }
        began.elapsed()
    };
    let (mut known, began) = (Vec::new(), Instant::now());
    for round in 0..1000 {
        if round % 20 == 0 {
            engine.frame(&scene.cameras[round / 20 % 3].camera, Duration::from_millis(10)).expect("a frame");
        }
        let mut link = link::connect(door.invitation()).expect("somebody answers");
        link.send(&hello.to_bytes()).expect("a walk");
        let incarnation = (0..1000).find_map(|_| {
            let said = link.next(Duration::from_millis(10)).expect("a walk")?;
            match ToGuest::of_bytes(&said) {
                Some(ToGuest::Welcome { incarnation, .. }) => Some(incarnation),
                _ => None,
            }
        });
        let incarnation = incarnation.expect("a welcome");
        link.send(&FromGuest::Ready { incarnation }.to_bytes()).expect("a walk");
        serves(1);
        drop(link);
        known.push(serves(0));
    }
    let took = began.elapsed();
    known.sort();
    let (median, most) = (known[known.len() / 2], known[known.len() - 1]);
    let picture = converged(&mut engine);
    engine.finish(Duration::from_secs(20));
    let (stations, jobs) = (engine.stations(), engine.actors().pool.as_ref().expect("a pool").stats());
    println!("1,000 guests in {took:?}: gone is known after {median:?}, at most {most:?}; {stations:?}");
    assert!(picture == expected, "another picture: {stations:?}");
    assert!(jobs.twice == 0 && stations[0].counts.banned == 0, "{jobs:?}, {stations:?}");
    assert!(median <= Duration::from_millis(50), "{median:?} until it is known that a guest is gone");
}

#[test]
fn who_is_another_version_or_has_other_bits_is_told_so() {
    let package = Arc::new(Package::of(&opened()).expect("a package"));
    let mut hall = Hall::new(package, 6, 1);
    let mut says = |peer, message: FromGuest| {
        let mut effects = Vec::new();
        hall.heard(Event::Opened(peer), &mut effects);
        hall.heard(Event::Message(peer, message.to_bytes()), &mut effects);
        effects
            .into_iter()
            .find_map(|effect| if let Effect::Send(_, said) = effect { Some(said) } else { None })
    };
    let hello = |protocol, program: String, bits| FromGuest::Hello {
        protocol,
        program,
        bits,
        cores: 1,
        name: "n".into(),
        memory: None,
    };
    let refused =
        |said: Option<ToGuest>| if let Some(ToGuest::Refused(why)) = said { Some(why) } else { None };
    let version = refused(says(0, hello(PROTOCOL + 1, program(), bits::probe())));
    assert!(matches!(version, Some(Refusal::Version { .. })), "{version:?}");
    assert!(matches!(refused(says(1, hello(PROTOCOL, "other".into(), 0))), Some(Refusal::Version { .. })));
    let wanted = bits::probe();
    assert_eq!(refused(says(2, hello(PROTOCOL, program(), wanted ^ 1))), Some(Refusal::OtherBits { wanted }));
    let FromGuest::Hello { protocol, program: of, bits, cores, name, .. } =
        hello(PROTOCOL, program(), wanted)
    else {
        panic!("a hello");
    };
    let small = FromGuest::Hello { protocol, program: of, bits, cores, name, memory: Some(100) };
    assert!(matches!(refused(says(6, small)), Some(Refusal::TooSmall { bytes }) if bytes > 100));
    assert!(matches!(says(3, hello(PROTOCOL, program(), wanted)), Some(ToGuest::Welcome { .. })));
    assert_eq!(refused(says(4, hello(PROTOCOL, program(), wanted))), Some(Refusal::Full));
    assert_eq!(refused(says(5, FromGuest::Ready { incarnation: 0 })), Some(Refusal::Banned));
}

/// A guest leaves, another one takes its place, and only then the station has found out that the first one lied: the ban is
/// not for who sits there now, nor are jobs.
#[test]
fn a_ban_that_comes_late_hits_nobody_else() {
    let package = Arc::new(Package::of(&opened()).expect("a package"));
    let mut hall = Hall::new(package, 16, 1);
    let joins = |hall: &mut Hall, peer| {
        let mut effects = Vec::new();
        hall.heard(Event::Opened(peer), &mut effects);
        hall.heard(Event::Message(peer, hello(1, "n".into()).to_bytes()), &mut effects);
        let welcomed = effects.iter().find_map(|effect| match effect {
            Effect::Send(_, ToGuest::Welcome { incarnation, .. }) => Some(*incarnation),
            _ => None,
        });
        let incarnation = welcomed.expect("there is room");
        hall.heard(Event::Message(peer, FromGuest::Ready { incarnation }.to_bytes()), &mut effects);
        incarnation
    };
    let liar = joins(&mut hall, 1);
    hall.heard(Event::Closed(1), &mut Vec::new());
    let honest = joins(&mut hall, 2);
    let ban = || ToGuest::Refused(Refusal::Banned);
    for late in [ToGuest::Jobs(Vec::new()), ban()] {
        let mut effects = Vec::new();
        hall.passes(0, liar, late, &mut effects);
        assert!(effects.is_empty() && hall.serving() == 1);
    }
    let mut effects = Vec::new();
    hall.passes(0, honest, ban(), &mut effects);
    assert!(!effects.is_empty() && hall.serving() == 0);
}

/// What a guest is sent is the scene, and what it is not asked for it does not get.
#[test]
fn a_package_holds_what_the_scene_is_read_from() {
    let opened = opened();
    let package = Package::of(&opened).expect("a package");
    let (hash, bytes) = package.manifest();
    let list = package.piece(&hash, 0).expect("the list");
    assert_eq!(list.len() as u64, bytes);
    let manifest = Manifest::of_bytes(&list).expect("sound");
    assert_eq!(manifest.content_hash, opened.world.scene.content_hash);
    assert!(manifest.files.iter().any(|entry| entry.name == "box.toml"), "{:?}", manifest.files);
    for (hash, bytes) in manifest.blobs() {
        assert!(package.piece(&hash, bytes + 1).is_none() && package.piece(&hash, bytes) == Some(Vec::new()));
    }
    assert!(package.piece(&[0; 32], 0).is_none());
}
