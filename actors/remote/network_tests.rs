//! Walks over a simulated network that loses, delays, doubles and reorders what it is given, with guests that are slow, lie
//! or send what is no message, by seeds. Whatever happens, a view converges to the bits of a walk without guests, and its
//! recording replays without them.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use foveal::display::cpu_pass::PartlyDrawn;
use foveal::rng::hash;
use foveal::sampling::Lattice;
use foveal_actors::station::wire::{Body, DoneJob, FromGuest, JobSpec, Order, Refusal, ToGuest, ViewSpec};
use foveal_actors::station::{Heard, Outlet, StationStatus};
use foveal_engine::opened::Opened;
use foveal_engine::{Engine, Options, Recording, Settings, Standing};

use crate::door::{Effect, Hall, Letting};
use crate::link::Event;
use crate::package::Package;
use crate::tests::{WAIT, hello, local, opened, refining, replays, settings, still};
use crate::work;

/// What a simulated guest does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Behaviour {
    Honest,
    /// Answers at times not at all.
    Slow,
    /// A few colours are not those of the scene.
    Liar,
    /// Sends bytes that are no message.
    Corrupt,
    /// Of a machine whose numbers have other bits.
    Other,
}

/// A guest without threads: it answers when it is asked, and a network stands between.
struct SimGuest {
    peer: u64,
    behaviour: Behaviour,
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
    /// Whether all guests are machines of other bits.
    others: bool,
    way: Vec<OnTheWay>,
    hall: Hall,
    guests: Vec<SimGuest>,
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

    fn join(&mut self, behaviour: Behaviour, tell: &mut dyn FnMut(usize, Heard)) {
        let peer = self.peers;
        self.peers += 1;
        self.guests.push(SimGuest {
            peer,
            behaviour,
            incarnation: None,
            views: Vec::new(),
            refused: None,
            lied: false,
        });
        let mut hello = hello(1 + self.number(3) as u16, format!("{behaviour:?} {peer}"));
        if let (FromGuest::Hello { bits, .. }, true) = (&mut hello, self.others) {
            *bits ^= 1;
        }
        let mut effects = Vec::new();
        self.hall.heard(Event::Opened(peer), &mut effects);
        self.hall.heard(Event::Message(peer, hello.to_bytes()), &mut effects);
        self.effects(effects, tell);
    }

    fn leave(&mut self, which: usize, tell: &mut dyn FnMut(usize, Heard)) {
        let peer = self.guests.remove(which).peer;
        let mut effects = Vec::new();
        self.hall.heard(Event::Closed(peer), &mut effects);
        self.effects(effects, tell);
    }

    fn effects(&mut self, effects: Vec<Effect>, tell: &mut dyn FnMut(usize, Heard)) {
        for effect in effects {
            match effect {
                Effect::Send(peer, message) => self.put(Moving::ToGuest(peer, message)),
                Effect::Close(_) | Effect::Grounded(..) | Effect::Worked(..) => {}
                Effect::Tell(station, heard) => tell(station, heard),
            }
        }
    }

    fn turn(&mut self, world: &foveal::world::World, k_max: u32, tell: &mut dyn FnMut(usize, Heard)) {
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
        let (draw, faults, others) = (self.number(1 << 30), self.faults, self.others);
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
                if faults && guest.behaviour == Behaviour::Slow && draw.is_multiple_of(3) {
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
                    // Among machines of other bits some of what is compared may differ: who lies there lies often, so that few
                    // answers tell, however few a slow machine has time for.
                    let lies = guest.behaviour == Behaviour::Liar
                        && (draw ^ job.lease).is_multiple_of(if others { 2 } else { 4 });
                    // A block of other samples looks as likely as the one that was asked for.
                    let is_block = matches!(job.order, Order::Block(_));
                    let told = if lies && is_block { JobSpec { seed: job.seed ^ 1, ..job } } else { job };
                    let mut found = work::found(world, &lattice, drawn, &told, &|| true);
                    guest.lied |= lies && is_block;
                    if let Some(Body::Colors(found)) = &mut found {
                        let lies = lies && !found.colors.is_empty();
                        guest.lied |= lies;
                        for color in
                            found.colors.iter_mut().take(if lies { 1 + draw as usize % 64 } else { 0 })
                        {
                            color.x += 0.25;
                        }
                        if guest.behaviour == Behaviour::Other {
                            // As functions that round in other ways: nearly the same, and now and then another path.
                            for (i, color) in found.colors.iter_mut().enumerate() {
                                *color *= 1.0 + f32::EPSILON;
                                if hash(draw, i as u64, job.lease).is_multiple_of(200) {
                                    color.y *= 2.0;
                                }
                            }
                        }
                    }
                    done.push(DoneJob { lease: job.lease, micros: 300, found });
                }
                if guest.behaviour == Behaviour::Corrupt && draw.is_multiple_of(5) {
                    return vec![vec![0xff; 1 + draw as usize % 40]];
                }
                let Some(incarnation) = guest.incarnation else { return Vec::new() };
                vec![FromGuest::Done { incarnation, jobs: done }.to_bytes()]
            }
            // Of work in pieces walks have none.
            ToGuest::Ground { .. } | ToGuest::Work { .. } => panic!("{message:?}"),
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

struct Outcome {
    picture: Vec<u8>,
    stations: Vec<StationStatus>,
    /// Guests that lied, and those of them that nobody has told that they are banned.
    liars: usize,
    unnoticed: usize,
    banned: usize,
}

/// A walk over a simulated network: two views with faults, then the start view without, until it has converged and been refined,
/// if these settings refine it.
fn simulated(
    opened: &Opened,
    package: &Arc<Package>,
    seed: u64,
    settings: Settings,
    letting: Letting,
    recording: Option<&Path>,
) -> Outcome {
    let stations = settings.stations;
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
    let hall = Hall::new(Arc::clone(package), settings.k_max, stations).letting(letting);
    let mut network = SimNetwork {
        seed,
        drawn: 0,
        step: 0,
        faults: true,
        others: letting.any_bits,
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
        let behaviour = match network.number(6) {
            _ if letting.any_bits && seed.is_multiple_of(5) => Behaviour::Liar,
            _ if letting.any_bits => Behaviour::Other,
            0 => Behaviour::Slow,
            1 | 2 => Behaviour::Liar,
            3 => Behaviour::Corrupt,
            _ => Behaviour::Honest,
        };
        network.join(behaviour, &mut tell);
    }
    let world = &opened.world;
    let cameras = [1, 2, 0].map(|i| world.scene.cameras[i].camera);
    let (mut liars, mut unnoticed, mut banned) = (0, 0, 0);
    let mut count = |guests: &[SimGuest]| {
        let is_banned = |guest: &&SimGuest| guest.refused == Some(Refusal::Banned);
        liars += guests.iter().filter(|guest| guest.lied).count();
        unnoticed += guests.iter().filter(|guest| guest.lied && !is_banned(guest)).count();
        let wrongly = |guest: &SimGuest| {
            matches!(guest.behaviour, Behaviour::Honest | Behaviour::Slow | Behaviour::Other)
        };
        assert!(
            !guests.iter().any(|guest| is_banned(&guest) && wrongly(guest)),
            "seed {seed}: an honest one is banned"
        );
        banned += guests.iter().filter(is_banned).count();
    };
    let began = Instant::now();
    for (round, camera) in cameras.iter().enumerate() {
        network.faults = round < 2 && !letting.any_bits;
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
                network.join(Behaviour::Honest, &mut tell);
            }
            let frame = engine.end().expect("a frame");
            frames += 1;
            if round < 2 && frames == if letting.any_bits { 10 } else { 4 } {
                break;
            }
            let end = if settings.supersampling.is_some() { Standing::Refined } else { Standing::Converged };
            if round == 2 && frame.standing == end {
                count(&network.guests);
                let picture = frame.snapshot.rgb8.data().as_flattened().to_vec();
                engine.finish(Duration::from_secs(20));
                let stations = engine.stations();
                let jobs = engine.actors().pool.as_ref().expect("a pool").stats();
                assert_eq!(jobs.twice, 0, "seed {seed}: {jobs:?}");
                return Outcome { picture, stations, liars, unnoticed, banned };
            }
            assert!(began.elapsed() < WAIT, "seed {seed} does not converge");
        }
    }
    unreachable!("the last round returns")
}

/// Seeds of simulated networks: 24, or what `FOVEAL_SEEDS` says, how many or `FIRST..END`, so that many can be run in parts.
pub(super) fn seeds() -> std::ops::Range<u64> {
    let Ok(wanted) = std::env::var("FOVEAL_SEEDS") else { return 0..24 };
    let number = |text: &str| text.parse().expect("FOVEAL_SEEDS is a number or FIRST..END");
    match wanted.split_once("..") {
        Some((first, end)) => number(first)..number(end),
        None => 0..number(&wanted),
    }
}

#[test]
fn whatever_network_and_guests_do_a_view_converges_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    let opened = opened();
    let package = Arc::new(Package::of(&opened).expect("a package"));
    let expected = [local(&opened), still(&opened, refining(settings(0)))];
    let seeds = seeds();
    let (mut samples, mut returned, mut late, mut liars, mut banned) = (0, 0, 0, 0, 0);
    for seed in seeds.clone() {
        let recording = (seed % 4 == 0).then(|| folder.path().join(format!("{seed}.fvlog")));
        // Some go on until the view is refined.
        let (stations, refines) = (1 + (seed % 3) as u32, seed % 8 < 2);
        let settings = settings(stations);
        let settings = if refines { refining(settings) } else { settings };
        let played = simulated(&opened, &package, seed, settings, Letting::default(), recording.as_deref());
        let is_true = played.picture == expected[usize::from(refines)] || played.unnoticed > 0;
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

/// Machines whose numbers have other bits are let in where that was asked for, though some of their samples come to something
/// else; the picture is near to the one without them, and the recording, which holds what they found, replays. Who lies is found
/// out among them, too.
#[test]
fn machines_of_other_bits_may_trace_where_they_are_let_in() {
    let folder = tempfile::tempdir().expect("a folder");
    let opened = opened();
    let package = Arc::new(Package::of(&opened).expect("a package"));
    let letting = Letting { any_bits: true, payloads: false };
    let looks_often = Settings { checked: 16, ..settings(2) };
    for (seed, settings) in [(3, settings(2)), (4, refining(settings(2))), (5, looks_often)] {
        let recording = folder.path().join(format!("{seed}.fvlog"));
        let played = simulated(&opened, &package, seed, settings, letting, Some(&recording));
        let expected = still(&opened, Settings { stations: 0, ..settings });
        let samples: u64 = played.stations.iter().map(|station| station.counts.samples).sum();
        if seed == 5 {
            assert!(played.banned > 0, "{:?}", played.stations);
            continue;
        }
        assert!(samples > 200 && played.banned == 0, "{:?}", played.stations);
        let pairs = played.picture.iter().zip(&expected);
        let off = pairs.filter(|(a, b)| a.abs_diff(**b) > 2).count() as f32 / expected.len() as f32;
        println!("seed {seed}: {samples} samples from elsewhere, {off} of all values are others");
        assert!(off < 0.02, "{off} of all values are others");
        replays(&recording, false);
    }
}
