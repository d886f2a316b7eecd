//! References and bakes in pieces over a simulated network, by seeds, with guests that are slow, lie, send what is no answer,
//! come and go: whatever happens, they have the bits of one machine.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use foveal::illumination::bake::{BakeSettings, Baker};
use foveal::illumination::stored::Illumination;
use foveal::rng::hash;
use foveal::scene::camera::CameraFrame;
use foveal::world::World;
use foveal_actors::station::wire::{FromGuest, Refusal, ToGuest};
use foveal_engine::batch::{Alone, Handed, Hands, Piece};
use foveal_engine::glam::Vec3;
use foveal_engine::light::Reading;
use foveal_engine::opened::Opened;
use foveal_engine::reference::{Enough, sampled_bidirectional_by, sampled_paths_by, traced_picture_by};
use foveal_files::bakes::decode;

use crate::ground::{OwnGround, Pass};
use crate::hands::{Helped, MAP_KEY};
use crate::key::Key;
use crate::link::{Event, HostLink, Peer, Waker};
use crate::package::Package;
use crate::tests::{hello, opened, scene};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Nature {
    Honest,
    /// Answers at times not at all.
    Slow,
    /// Some bits of what it found are others.
    Liar,
    /// Sends bytes that are no message.
    Corrupt,
}

/// A ground's number and task, its light's hash and bytes.
type ToldOf = (u32, Vec<u8>, Option<([u8; 32], u64)>);

struct Played {
    peer: Peer,
    nature: Nature,
    incarnation: u64,
    ground: Option<OwnGround>,
    /// The ground that it is told of, and what of its light came.
    told: Option<ToldOf>,
    map: Vec<u8>,
}

/// What came to pass, told to the test.
#[derive(Default)]
struct Told {
    pieces: AtomicU64,
    lies: AtomicU64,
    banned: AtomicU64,
    wrongly: AtomicU64,
}

/// A link whose guests are simulated on the door's own thread.
struct SimLink {
    seed: u64,
    drawn: u64,
    step: u64,
    world: World,
    guests: Vec<Played>,
    way: VecDeque<(u64, Event)>,
    peers: Peer,
    most: usize,
    told: Arc<Told>,
}

impl SimLink {
    fn number(&mut self, below: u64) -> u64 {
        self.drawn += 1;
        hash(self.seed, self.drawn, 3) % below
    }

    fn put(&mut self, delay: u64, event: Event) {
        self.way.push_back((self.step + delay, event));
    }

    fn join(&mut self) {
        let nature = match self.number(6) {
            0 => Nature::Slow,
            1 | 2 => Nature::Liar,
            3 => Nature::Corrupt,
            _ => Nature::Honest,
        };
        let (peer, cores) = (self.peers, 1 + self.number(3) as u16);
        self.peers += 1;
        let (told, ground, map) = (None, None, Vec::new());
        self.guests.push(Played { peer, nature, incarnation: 0, ground, told, map });
        self.put(1, Event::Opened(peer));
        self.put(1, Event::Message(peer, hello(cores, format!("{nature:?} {peer}")).to_bytes()));
    }

    /// What a guest says to a message.
    fn answers(&mut self, peer: Peer, message: ToGuest) -> Vec<FromGuest> {
        let draw = self.number(1 << 30);
        let Some(guest) = self.guests.iter_mut().find(|guest| guest.peer == peer) else { return Vec::new() };
        let incarnation = guest.incarnation;
        match message {
            ToGuest::Welcome { incarnation, .. } => {
                guest.incarnation = incarnation;
                vec![FromGuest::Ready { incarnation }]
            }
            ToGuest::Ground { number, task, map } => {
                (guest.told, guest.map) = (Some((number, task, map)), Vec::new());
                match map {
                    Some((hash, _)) => vec![FromGuest::Want { hash, at: 0 }],
                    None => guest.settle(&self.world),
                }
            }
            ToGuest::Piece { hash, bytes, .. } => {
                guest.map.extend(bytes);
                match guest.told {
                    Some((_, _, Some((_, whole)))) if (guest.map.len() as u64) < whole => {
                        vec![FromGuest::Want { hash, at: guest.map.len() as u64 }]
                    }
                    _ => guest.settle(&self.world),
                }
            }
            ToGuest::Work { lease, ground, piece } => {
                if guest.nature == Nature::Slow && draw.is_multiple_of(3) {
                    return Vec::new();
                }
                let own = guest.ground.as_ref().filter(|own| own.number == ground).expect("a ground it has");
                let piece: Piece = postcard::from_bytes(&piece).expect("a piece");
                assert!(own.has(&piece), "{piece:?}");
                let found = own.with(&Pass::default(), |ground| ground.done(&piece, &|| true)).expect("done");
                let mut found = postcard::to_stdvec(&found).expect("bytes");
                if guest.nature == Nature::Liar && draw.is_multiple_of(4) {
                    let at = draw as usize / 4 % found.len();
                    found[at] ^= 1 << (draw % 7);
                    self.told.lies.fetch_add(1, Ordering::SeqCst);
                }
                self.told.pieces.fetch_add(1, Ordering::SeqCst);
                vec![FromGuest::Worked { incarnation, lease, micros: 300, waiting: draw as u32 % 3, found }]
            }
            ToGuest::Refused(refusal) => {
                if refusal == Refusal::Banned {
                    let honest = matches!(guest.nature, Nature::Honest | Nature::Slow);
                    self.told.banned.fetch_add(1, Ordering::SeqCst);
                    self.told.wrongly.fetch_add(u64::from(honest), Ordering::SeqCst);
                }
                Vec::new()
            }
            _ => Vec::new(),
        }
    }
}

impl Played {
    /// It has what pieces are of.
    fn settle(&mut self, world: &World) -> Vec<FromGuest> {
        let Some((number, task, map)) = self.told.take() else { return Vec::new() };
        let map = map.map(|(hash, _)| {
            assert_eq!(blake3::hash(&self.map), blake3::Hash::from(hash));
            decode::<Illumination>(&MAP_KEY, &self.map).expect("a map")
        });
        let task = postcard::from_bytes(&task).expect("a task");
        let ground = OwnGround::new(number, world, task, map, self.ground.as_ref());
        self.ground = Some(ground.expect("sound"));
        vec![FromGuest::Grounded { incarnation: self.incarnation, number }]
    }
}

impl HostLink for SimLink {
    fn next(&mut self, wait: Duration) -> Option<Event> {
        self.step += 1;
        if self.guests.len() < self.most {
            self.join();
        } else if self.number(60) == 0 {
            // Killed; another one comes.
            let which = self.number(self.guests.len() as u64) as usize;
            let peer = self.guests.remove(which).peer;
            self.put(1, Event::Closed(peer));
        }
        match self.way.iter().position(|(at, _)| *at <= self.step) {
            Some(at) => self.way.remove(at).map(|(_, event)| event),
            None => {
                std::thread::park_timeout(wait.min(Duration::from_micros(200)));
                None
            }
        }
    }

    fn send(&mut self, to: Peer, message: &[u8]) {
        let message = ToGuest::of_bytes(message).expect("what a walk sends can be read");
        for answer in self.answers(to, message) {
            let work = matches!(answer, FromGuest::Worked { .. });
            let corrupt = self.guests.iter().any(|g| g.peer == to && g.nature == Nature::Corrupt);
            let bytes = match corrupt && work && self.number(5) == 0 {
                true => vec![0xff; 1 + self.number(40) as usize],
                false => answer.to_bytes(),
            };
            // Answers to work come late, in any order, twice.
            let delay = if work { 1 + self.number(8) } else { 1 };
            if work && self.number(12) == 0 {
                let again = 1 + self.number(20);
                self.put(again, Event::Message(to, bytes.clone()));
            }
            self.put(delay, Event::Message(to, bytes));
        }
    }

    fn close(&mut self, peer: Peer) {
        self.guests.retain(|guest| guest.peer != peer);
    }

    fn address(&self) -> String {
        "simulated".into()
    }

    fn waker(&self) -> Waker {
        Waker(std::thread::current())
    }
}

/// What is made: the same by any hands.
fn made(kind: u64, hands: &dyn Hands, opened: &Opened, frame: &CameraFrame) -> Vec<u8> {
    let world = &opened.world;
    let bits = |colors: &[Vec3]| {
        colors.iter().flat_map(|c| c.to_array()).flat_map(|v| v.to_bits().to_le_bytes()).collect::<Vec<u8>>()
    };
    let goes_on = || true;
    match kind {
        0 => bits(traced_picture_by(hands, world, frame, 3, 1, &goes_on).picture.data()),
        1 => bits(traced_picture_by(hands, world, frame, 3, 5, &goes_on).picture.data()),
        2 => bits(sampled_paths_by(hands, world, frame, 3, &Enough::samples(5), &goes_on).picture.data()),
        3 => bits(
            sampled_bidirectional_by(hands, world, frame, 3, &Enough::samples(3), &goes_on).picture.data(),
        ),
        _ => {
            let settings = BakeSettings { texels: 600, particles: Some(1 << 16), ..BakeSettings::default() };
            let mut baker = Baker::new(world.indexed(), &settings);
            let handed = Handed { hands, settings: &settings };
            let baked = baker.run_by(world.indexed(), &handed, &|_| true, &mut |_| {});
            assert!(baked.complete);
            postcard::to_stdvec(&baked.illumination).expect("bytes")
        }
    }
}

#[test]
fn whatever_guests_do_references_and_bakes_have_the_bits_of_one_machine() {
    let opened = opened();
    let frame = opened.world.scene.cameras[0].camera.frame(160, 120);
    let expected: Vec<Vec<u8>> = (0..5).map(|kind| made(kind, &Alone, &opened, &frame)).collect();
    let told = Arc::new(Told::default());
    let hash = opened.world.scene.content_hash;
    let seeds = crate::network_tests::seeds();
    let (mut counted, mut doubted) = (0, 0);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    for seed in seeds.clone() {
        let package = Package::without_light(&scene(), &Reading::default(), hash).expect("a package");
        let (world, told) = (opened.world.clone(), Arc::clone(&told));
        let most = 1 + (seed % 3) as usize;
        let link = move || {
            let (way, guests) = (VecDeque::new(), Vec::new());
            let link = SimLink { seed, drawn: 0, step: 0, world, guests, way, peers: 0, most, told };
            Ok(Box::new(link) as Box<dyn HostLink>)
        };
        // All answers are checked, so that no lie is believed.
        let helped = Helped::over(link, Key::new().expect("a key"), package, 3, 1).expect("a door");
        while helped.serving() == 0 {
            std::thread::sleep(Duration::from_micros(100));
        }
        let kind = seed % 5;
        let made = loop {
            // One thread here, or guests would get nothing to do.
            let made = one.install(|| made(kind, &helped, &opened, &frame));
            if !helped.doubts() {
                break made;
            }
            doubted += 1;
        };
        assert!(made == expected[kind as usize], "seed {seed}, {kind}: other bits");
        counted += helped.close().iter().map(|guest| guest.pieces).sum::<u64>();
    }
    let of = |count: &AtomicU64| count.load(Ordering::SeqCst);
    println!(
        "seeds {seeds:?}: {} pieces done by guests, {counted} counted, {} lies, {} banned, {doubted} made anew",
        of(&told.pieces),
        of(&told.lies),
        of(&told.banned)
    );
    assert_eq!(of(&told.wrongly), 0, "an honest one is banned");
    assert!(seeds.end - seeds.start < 16 || counted > 100 && of(&told.lies) > 0 && of(&told.banned) > 0);
}
