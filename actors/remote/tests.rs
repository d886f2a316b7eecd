//! Walks with guests on threads of this process: over loopback, and over a network that loses, delays, doubles and reorders
//! what it is given, by seeds. Whatever happens, a view converges to the bits of a walk without guests, and its recording
//! replays without them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use foveal::display::cpu_pass::PartlyDrawn;
use foveal::rng::hash;
use foveal::sampling::Lattice;
use foveal_actors::station::wire::{DoneJob, FromGuest, PROTOCOL, Refusal, ToGuest, ViewSpec};
use foveal_actors::station::{Found, Heard, Outlet, StationStatus, bits};
use foveal_engine::opened::{self, Opened};
use foveal_engine::recording::Elsewhere;
use foveal_engine::replay::{How, Source};
use foveal_engine::{Engine, Light, Options, Recording, Settings, Standing};

use crate::door::{Door, Effect, Hall};
use crate::guest::{self, Done, End, Host, Progress};
use crate::key::{Invitation, Key};
use crate::link::{self, Event};
use crate::package::{Manifest, Package};
use crate::{program, work};

const WAIT: Duration = Duration::from_secs(120);

fn scene() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/box/box.toml")
}

fn opened() -> Opened {
    let light = Light { quick: true, ..Light::default() };
    opened::open(&scene(), &light, &()).expect("a scene")
}

fn settings(stations: u32) -> Settings {
    Settings { stations, samples_per_job: 64, ..Settings::new(96, 72, 1) }
}

/// Frames of a still view until it has converged; its picture.
fn converged(engine: &mut Engine) -> Vec<u8> {
    let camera = engine.opened().world.scene.cameras[0].camera;
    let began = Instant::now();
    loop {
        let frame = engine.frame(&camera, Duration::from_millis(20)).expect("a frame");
        if frame.standing == Standing::Converged {
            return frame.snapshot.rgb8.data().as_flattened().to_vec();
        }
        assert!(began.elapsed() < WAIT, "it does not converge");
    }
}

fn local(opened: &Opened) -> Vec<u8> {
    let mut engine = Engine::start(opened.clone(), Options::new(settings(0))).expect("actors");
    converged(&mut engine)
}

/// A recording replays to its end; one of a walk with liars in it may also stop, at the station that believed one before it
/// was found out: it has the hash of what was sent, and the scene says otherwise.
fn replays(recording: &Path, with_liars: bool) {
    let source = Source::open(recording, &Elsewhere::default(), true, &()).expect("a recording");
    let (mut runtime, _) = source.run(How { threads: 2, ..How::default() }, |_| {}).expect("replays");
    let report = runtime.replay_report();
    match &report.divergence {
        None => assert!(report.complete, "{report:?}"),
        Some(at) => assert!(with_liars && at.name.starts_with("station") && at.kind == "Done", "{report:?}"),
    }
}

struct Nobody(Arc<AtomicBool>);

impl Host for Nobody {
    fn leaves(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn progress(&mut self, _: Progress) {}
}

fn guest(
    invitation: &Invitation,
    stock: &Path,
    leaves: &Arc<AtomicBool>,
) -> std::thread::JoinHandle<(End, Done)> {
    let (invitation, leaves) = (invitation.clone(), Nobody(Arc::clone(leaves)));
    let stock = stock.to_owned();
    let stay = move || {
        let (mut leaves, mut done) = (leaves, Done::default());
        let mut link = link::connect(&invitation).expect("somebody answers");
        let options = guest::Options { cores: 1, stock, stock_bytes_max: 1 << 30, name: "a test".into() };
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
    let door = Door::open(address, Key::new().unwrap(), package, settings.k_max, 3).expect("a door");
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
            colors: None,
        };
        let heard = Heard::Done { incarnation: 3, salt: u64::MAX, jobs: (0..jobs).map(found).collect() };
        let bytes = postcard::to_stdvec(&heard).expect("it is recorded").len();
        bytes as f32 / jobs as f32
    };
    println!("{} B where one comes alone, {} B a job of eight", of(1), of(8));
    assert!(of(8) <= 20.0, "{} B a job", of(8));
}

/// What a simulated guest does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Nature {
    Honest,
    /// Answers at times not at all.
    Slow,
    /// A few colours are not those of the scene.
    Liar,
    /// Sends bytes that are no message.
    Corrupt,
}

/// A guest without threads: it answers when it is asked, and a network stands between.
struct Played {
    peer: u64,
    nature: Nature,
    incarnation: Option<u64>,
    views: Vec<(ViewSpec, PartlyDrawn)>,
    refused: Option<Refusal>,
    lied: bool,
}

/// What is on its way: when it arrives, in the network's steps.
struct OnTheWay {
    at: u64,
    what: Moving,
}

enum Moving {
    ToGuest(u64, ToGuest),
    FromGuest(u64, Vec<u8>),
}

/// A network between a hall and guests, by a seed.
struct SimNetwork {
    seed: u64,
    drawn: u64,
    step: u64,
    faults: bool,
    way: Vec<OnTheWay>,
    hall: Hall,
    guests: Vec<Played>,
    peers: u64,
    /// Until then nothing gets through.
    cut: u64,
}

impl SimNetwork {
    fn chance(&mut self, of: u64) -> bool {
        self.drawn += 1;
        hash(self.seed, self.drawn, 1).is_multiple_of(of)
    }

    fn number(&mut self, below: u64) -> u64 {
        self.drawn += 1;
        hash(self.seed, self.drawn, 2) % below
    }

    /// Some of it is lost, late or twice. What was lost before comes back as a new connection in truth, so only what the
    /// protocol survives is lost: views, jobs and answers.
    fn put(&mut self, what: Moving) {
        let (lossy, twice) = match &what {
            Moving::ToGuest(_, ToGuest::View(_) | ToGuest::Jobs(_) | ToGuest::Retire { .. }) => (true, true),
            Moving::FromGuest(_, bytes) => {
                let done = matches!(FromGuest::of_bytes(bytes), Some(FromGuest::Done { .. }));
                (done, done)
            }
            Moving::ToGuest(..) => (false, false),
        };
        let is_cut = self.step < self.cut;
        if self.faults && lossy && (is_cut || self.chance(20)) {
            return;
        }
        let delay = if self.faults && lossy { self.number(6) } else { 1 };
        if self.faults && twice && self.chance(15) {
            let again = match &what {
                Moving::ToGuest(peer, message) => Moving::ToGuest(*peer, message.clone()),
                Moving::FromGuest(peer, bytes) => Moving::FromGuest(*peer, bytes.clone()),
            };
            let at = self.step + 1 + self.number(12);
            self.way.push(OnTheWay { at, what: again });
        }
        self.way.push(OnTheWay { at: self.step + delay, what });
    }

    fn join(&mut self, nature: Nature, tell: &mut dyn FnMut(usize, foveal_actors::station::Heard)) {
        let peer = self.peers;
        self.peers += 1;
        self.guests.push(Played {
            peer,
            nature,
            incarnation: None,
            views: Vec::new(),
            refused: None,
            lied: false,
        });
        let hello = FromGuest::Hello {
            protocol: PROTOCOL,
            program: program(),
            bits: bits::probe(),
            cores: 1 + self.number(3) as u16,
            name: format!("{nature:?} {peer}"),
        };
        let mut effects = Vec::new();
        self.hall.heard(Event::Opened(peer), &mut effects);
        self.hall.heard(Event::Message(peer, hello.to_bytes()), &mut effects);
        self.effects(effects, tell);
    }

    fn leave(&mut self, which: usize, tell: &mut dyn FnMut(usize, foveal_actors::station::Heard)) {
        let peer = self.guests.remove(which).peer;
        let mut effects = Vec::new();
        self.hall.heard(Event::Closed(peer), &mut effects);
        self.effects(effects, tell);
    }

    fn effects(&mut self, effects: Vec<Effect>, tell: &mut dyn FnMut(usize, foveal_actors::station::Heard)) {
        for effect in effects {
            match effect {
                Effect::Send(peer, message) => self.put(Moving::ToGuest(peer, message)),
                Effect::Close(_) => {}
                Effect::Tell(station, heard) => tell(station, heard),
            }
        }
    }

    fn turn(
        &mut self,
        world: &foveal::world::World,
        k_max: u32,
        tell: &mut dyn FnMut(usize, foveal_actors::station::Heard),
    ) {
        self.step += 1;
        if self.faults && self.chance(40) {
            self.cut = self.step + self.number(30);
        }
        let step = self.step;
        let (now, later): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.way).into_iter().partition(|w| w.at <= step);
        self.way = later;
        for OnTheWay { what, .. } in now {
            match what {
                Moving::FromGuest(peer, bytes) => {
                    let mut effects = Vec::new();
                    self.hall.heard(Event::Message(peer, bytes), &mut effects);
                    self.effects(effects, tell);
                }
                Moving::ToGuest(peer, message) => {
                    // Both sides read what the other one wrote.
                    let message =
                        ToGuest::of_bytes(&message.to_bytes()).expect("what a walk sends can be read");
                    for answer in self.answers(peer, message, world, k_max) {
                        self.put(Moving::FromGuest(peer, answer));
                    }
                }
            }
        }
    }

    fn answers(
        &mut self,
        peer: u64,
        message: ToGuest,
        world: &foveal::world::World,
        k_max: u32,
    ) -> Vec<Vec<u8>> {
        let (draw, faults) = (self.number(1 << 30), self.faults);
        let Some(guest) = self.guests.iter_mut().find(|guest| guest.peer == peer) else { return Vec::new() };
        match message {
            ToGuest::Welcome { incarnation, .. } => {
                guest.incarnation = Some(incarnation);
                vec![FromGuest::Ready { incarnation }.to_bytes()]
            }
            ToGuest::Refused(refusal) => {
                guest.refused = Some(refusal);
                Vec::new()
            }
            ToGuest::View(view) => {
                guest.views.push((view, PartlyDrawn::new(view.frame, view.cell)));
                Vec::new()
            }
            ToGuest::Jobs(jobs) => {
                if faults && guest.nature == Nature::Slow && draw.is_multiple_of(3) {
                    return Vec::new();
                }
                let mut done = Vec::new();
                for job in jobs {
                    let Some((view, drawn)) =
                        guest.views.iter_mut().rev().find(|(view, _)| view.view == job.view)
                    else {
                        continue;
                    };
                    let lattice = Lattice::new(k_max, view.frame.size.map(|side| side as i32 / 2));
                    assert!(job.fits(&lattice, view.frame.size));
                    let mut found = work::colors(world, &lattice, drawn, &job);
                    if guest.nature == Nature::Liar && !found.colors.is_empty() && (draw ^ job.lease) % 4 == 0
                    {
                        guest.lied = true;
                        for color in found.colors.iter_mut().take(1 + draw as usize % 64) {
                            color.x += 0.25;
                        }
                    }
                    done.push(DoneJob { lease: job.lease, micros: 300, found: Some(found) });
                }
                if guest.nature == Nature::Corrupt && draw.is_multiple_of(5) {
                    return vec![vec![0xff; 1 + draw as usize % 40]];
                }
                let Some(incarnation) = guest.incarnation else { return Vec::new() };
                vec![FromGuest::Done { incarnation, jobs: done }.to_bytes()]
            }
            ToGuest::Retire { .. } | ToGuest::Piece { .. } | ToGuest::Farewell => Vec::new(),
        }
    }
}

/// Keeps what a station sends for the network to take.
struct Pipe(Arc<crossbeam_queue::SegQueue<(usize, u64, ToGuest)>>, usize);

impl Outlet for Pipe {
    fn send(&mut self, incarnation: u64, message: ToGuest) {
        self.0.push((self.1, incarnation, message));
    }
}

struct Played1 {
    picture: Vec<u8>,
    stations: Vec<StationStatus>,
    /// Guests that lied, and those of them that nobody has told that they are banned.
    liars: usize,
    unnoticed: usize,
    banned: usize,
}

/// A walk over a simulated network: two views with faults, then the start view without, until it has converged.
fn simulated(opened: &Opened, package: &Arc<Package>, seed: u64, recording: Option<&Path>) -> Played1 {
    let stations = 1 + (seed % 3) as u32;
    let settings = settings(stations);
    let pipe = Arc::new(crossbeam_queue::SegQueue::new());
    let given = Arc::clone(&pipe);
    let outlets = move || {
        (0..stations as usize)
            .map(|i| Box::new(Pipe(Arc::clone(&given), i)) as Box<dyn Outlet>)
            .collect::<Vec<_>>()
    };
    let options = Options {
        outlets: Some(Arc::new(outlets)),
        recording: recording.map(|path| Recording::file(path, "test")),
        ..Options::new(settings)
    };
    let mut engine = Engine::start(opened.clone(), options).expect("actors");
    let inputs = engine.station_inputs();
    let hall = Hall::new(Arc::clone(package), settings.k_max, stations);
    let mut network = SimNetwork {
        seed,
        drawn: 0,
        step: 0,
        faults: true,
        way: Vec::new(),
        hall,
        guests: Vec::new(),
        peers: 0,
        cut: 0,
    };
    let mut tell = |station: usize, heard| {
        inputs[station].send(heard).expect("room for what a guest can say");
    };
    for _ in 0..stations {
        let nature = match network.number(6) {
            0 => Nature::Slow,
            1 | 2 => Nature::Liar,
            3 => Nature::Corrupt,
            _ => Nature::Honest,
        };
        network.join(nature, &mut tell);
    }
    let world = &opened.world;
    let cameras = [1, 2, 0].map(|i| world.scene.cameras[i].camera);
    let (mut liars, mut unnoticed, mut banned) = (0, 0, 0);
    let mut count = |guests: &[Played]| {
        let is_banned = |guest: &&Played| guest.refused == Some(Refusal::Banned);
        liars += guests.iter().filter(|guest| guest.lied).count();
        unnoticed += guests.iter().filter(|guest| guest.lied && !is_banned(guest)).count();
        let wrongly = |guest: &Played| matches!(guest.nature, Nature::Honest | Nature::Slow);
        assert!(
            !guests.iter().any(|guest| is_banned(&guest) && wrongly(guest)),
            "seed {seed}: an honest one is banned"
        );
        banned += guests.iter().filter(is_banned).count();
    };
    let began = Instant::now();
    for (round, camera) in cameras.iter().enumerate() {
        network.faults = round < 2;
        let mut frames = 0;
        loop {
            engine.begin(camera).expect("a view");
            for _ in 0..8 {
                engine.work_until(Duration::from_millis(1), |_| false).expect("works");
                while let Some((station, incarnation, message)) = pipe.pop() {
                    let mut effects = Vec::new();
                    network.hall.passes(station, incarnation, message, &mut effects);
                    network.effects(effects, &mut tell);
                }
                network.turn(world, settings.k_max, &mut tell);
            }
            if network.faults && network.chance(6) && !network.guests.is_empty() {
                // Killed; another one comes, or the same anew.
                let which = network.number(network.guests.len() as u64) as usize;
                count(&network.guests[which..=which]);
                network.leave(which, &mut tell);
                network.join(Nature::Honest, &mut tell);
            }
            let frame = engine.end().expect("a frame");
            frames += 1;
            if round < 2 && frames == 4 {
                break;
            }
            if round == 2 && frame.standing == Standing::Converged {
                count(&network.guests);
                let picture = frame.snapshot.rgb8.data().as_flattened().to_vec();
                engine.finish(Duration::from_secs(20));
                let stations = engine.stations();
                let jobs = engine.actors().pool.as_ref().expect("a pool").stats();
                assert_eq!(jobs.twice, 0, "seed {seed}: {jobs:?}");
                return Played1 { picture, stations, liars, unnoticed, banned };
            }
            assert!(began.elapsed() < WAIT, "seed {seed} does not converge");
        }
    }
    unreachable!("the last round returns")
}

/// Seeds of simulated networks: 24, or what `FOVEAL_SEEDS` says, how many or `FIRST..END`, so that many can be run in parts.
fn seeds() -> std::ops::Range<u64> {
    let Ok(wanted) = std::env::var("FOVEAL_SEEDS") else { return 0..24 };
    let number = |text: &str| text.parse().expect("FOVEAL_SEEDS is a number or FIRST..END");
    match wanted.split_once("..") {
        Some((first, end)) => number(first)..number(end),
        None => 0..number(&wanted),
    }
}

/// A thousand guests come and go one after the other, some with jobs that they never do: who is gone is known at once, and
/// the view converges to the bits of a walk without them.
#[test]
fn a_thousand_guests_that_come_and_go_change_no_bit() {
    let opened = opened();
    let expected = local(&opened);
    let package = Package::of(&opened).expect("a package");
    let settings = settings(1);
    let door =
        Door::open("tcp/127.0.0.1:0", Key::new().unwrap(), package, settings.k_max, 1).expect("a door");
    let options = Options { outlets: Some(door.outlets()), ..Options::new(settings) };
    let mut engine = Engine::start(opened, options).expect("actors");
    door.attach(engine.station_inputs());
    let scene = engine.opened().world.scene.clone();
    let hello = FromGuest::Hello {
        protocol: PROTOCOL,
        program: program(),
        bits: bits::probe(),
        cores: 1,
        name: "a passer-by".into(),
    };
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
fn whatever_network_and_guests_do_a_view_converges_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    let opened = opened();
    let package = Arc::new(Package::of(&opened).expect("a package"));
    let expected = local(&opened);
    let seeds = seeds();
    let (mut samples, mut returned, mut late, mut liars, mut banned) = (0, 0, 0, 0, 0);
    for seed in seeds.clone() {
        let recording = (seed % 4 == 0).then(|| folder.path().join(format!("{seed}.fvlog")));
        let played = simulated(&opened, &package, seed, recording.as_deref());
        let is_true = played.picture == expected || played.unnoticed > 0;
        assert!(is_true, "seed {seed}: another picture, {:?}", played.stations);
        if let Some(recording) = recording {
            replays(&recording, played.liars > 0);
        }
        for station in &played.stations {
            samples += station.counts.samples;
            returned += station.counts.returned;
            late += station.counts.late;
        }
        (liars, banned) = (liars + played.liars, banned + played.banned);
    }
    println!(
        "seeds {seeds:?}: {samples} samples, {returned} returned, {late} late, {liars} lied, {banned} banned"
    );
    // A single seed need not meet all of it.
    assert!(seeds.end - seeds.start < 16 || samples > 1000 && returned > 0 && late > 0 && banned > 0);
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
    };
    let refused =
        |said: Option<ToGuest>| if let Some(ToGuest::Refused(why)) = said { Some(why) } else { None };
    let version = refused(says(0, hello(PROTOCOL + 1, program(), bits::probe())));
    assert!(matches!(version, Some(Refusal::Version { .. })), "{version:?}");
    assert!(matches!(refused(says(1, hello(PROTOCOL, "other".into(), 0))), Some(Refusal::Version { .. })));
    let wanted = bits::probe();
    assert_eq!(refused(says(2, hello(PROTOCOL, program(), wanted ^ 1))), Some(Refusal::OtherBits { wanted }));
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
        let hello = FromGuest::Hello {
            protocol: PROTOCOL,
            program: program(),
            bits: bits::probe(),
            cores: 1,
            name: "n".into(),
        };
        hall.heard(Event::Opened(peer), &mut effects);
        hall.heard(Event::Message(peer, hello.to_bytes()), &mut effects);
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
