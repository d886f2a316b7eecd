//! Actors that do what an actor must not are found by replay at the very message where they did.

use crossbeam_queue::SegQueue;
use foveal_runtime::*;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::SystemTime;

use crate::common::*;
use crate::ring::{Msg, Token};

/// What an actor must not look at.
#[derive(Clone, Copy, Debug)]
enum Leak {
    /// The clock, behind the runtime's back.
    Clock,
    /// The order of a map with a random seed.
    Map,
    /// The same, by the last bits of sums.
    Float,
    /// Nothing.
    Nothing,
    /// A bit of its state, changed by hand.
    Hand,
}

/// Passes tokens to its neighbour; at one of them it leaks.
struct Leaky {
    to: Option<Address<Msg>>,
    leak: Option<(Leak, u64)>,
    state: u64,
    /// Whether the state's hash is told, so that the leak shows at once.
    digests: bool,
}

impl Actor for Leaky {
    type Msg = Msg;
    const NAME: &'static str = "leaky";

    fn handle(&mut self, message: Msg, cx: &mut Cx<'_, Msg>) {
        let Msg::Token(token) = message else { return };
        let mut digest = Digest::new();
        digest.u64(self.state);
        digest.u64(token.value);
        self.state = digest.finish();
        match self.leak.filter(|(_, at)| at + 1 == cx.index()) {
            Some((Leak::Clock, _)) => {
                let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).expect("after 1970");
                self.state ^= now.as_nanos() as u64 | 1;
            }
            Some((Leak::Map, _)) => {
                let map: HashMap<u32, u32> = (0..64).map(|key| (key, key)).collect();
                self.state ^=
                    map.keys().fold(1, |sum: u64, key| sum.wrapping_mul(31).wrapping_add(u64::from(*key)));
            }
            Some((Leak::Float, _)) => {
                // One sum has few values that it can round to; of sixteen it shows that their order is another.
                for _ in 0..16 {
                    let map: HashMap<u32, f32> = (1..256).map(|key| (key, 1.0 / key as f32)).collect();
                    let sum: f32 = map.values().sum();
                    self.state = self.state.rotate_left(5) ^ u64::from(sum.to_bits());
                }
            }
            Some((Leak::Hand, _)) => self.state ^= 1 << 7,
            Some((Leak::Nothing, _)) | None => {}
        }
        if let (Some(to), true) = (&self.to, token.hops > 0) {
            let token = Token { hops: token.hops - 1, value: self.state };
            cx.tell(to, Msg::Token(token)).expect("one token on its way");
        }
    }

    fn digest(&self) -> Option<u64> {
        self.digests.then_some(self.state)
    }
}

/// Throws the first token.
struct Thrower(Address<Msg>);

impl Actor for Thrower {
    type Msg = Msg;
    const NAME: &'static str = "thrower";

    fn started(&mut self, cx: &mut Cx<'_, Msg>) {
        cx.tell(&self.0, Msg::Token(Token { hops: 100, value: 3 })).expect("room");
    }

    fn handle(&mut self, _: Msg, _: &mut Cx<'_, Msg>) {}
}

fn wire(wiring: &mut Wiring, leak: (Leak, u64), digests: bool) {
    let leaky = [(); 2].map(|()| wiring.declare::<Leaky>(Bounds::messages(4)));
    let addresses = leaky.each_ref().map(Declared::address);
    let thrower = wiring.declare::<Thrower>(Bounds::messages(1));
    wiring.spawn(thrower, Thrower(addresses[0].clone()), OnPanic::Resume);
    for ((leaky, other), leak) in leaky.into_iter().zip([1, 0]).zip([None, Some(leak)]) {
        wiring.spawn(
            leaky,
            Leaky { to: Some(addresses[other].clone()), leak, state: 0, digests },
            OnPanic::Resume,
        );
    }
}

/// What the message at a place says in a replay.
fn says(trace: &Arc<Trace>, leak: (Leak, u64), digests: bool, place: (ActorId, u64)) -> Content {
    let found: Arc<SegQueue<Content>> = Arc::default();
    let sink = Arc::clone(&found);
    let observer: Observer = Arc::new(move |d: &Delivery<'_>| {
        if (d.actor, d.index) == place {
            sink.push((d.told)());
        }
    });
    let config = Config { observer: Some(observer), ..Config::replay(trace.clone(), 0) };
    let (mut runtime, ()) = Runtime::build(config, |wiring| wire(wiring, leak, digests)).expect("builds");
    assert!(runtime.replay().divergence.is_some());
    found.pop().expect("it comes there")
}

#[test]
fn what_an_actor_must_not_do_is_found_at_its_message() {
    let folder = tempfile::tempdir().expect("a folder");
    // What leaked while it was recorded, and in the replay.
    let leaks = [
        (Leak::Clock, Leak::Clock),
        (Leak::Map, Leak::Map),
        (Leak::Float, Leak::Float),
        (Leak::Nothing, Leak::Hand),
    ];
    for (number, (recorded, replayed)) in leaks.into_iter().enumerate() {
        for digests in [true, false] {
            let path = folder.path().join(format!("{number}-{digests}.fvlog"));
            let config = Config::live(2).record(&path);
            let (mut runtime, ()) =
                Runtime::build(config, |wiring| wire(wiring, (recorded, 17), digests)).expect("builds");
            assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
            runtime.shutdown(WAIT);
            let trace = Arc::new(Trace::open(&path).expect("reads"));
            // With the state's hash it is the message itself; without, the first that tells of it.
            let expected = if digests { (ActorId(1), 17) } else { (ActorId(0), 18) };
            for threads in [0, 2] {
                let config = Config::replay(trace.clone(), threads);
                let (mut runtime, ()) =
                    Runtime::build(config, |wiring| wire(wiring, (replayed, 17), digests)).expect("builds");
                let divergence = runtime.replay().divergence.expect("it leaks");
                assert_eq!((divergence.actor, divergence.index), expected, "{replayed:?}: {divergence}");
                assert_eq!((divergence.kind, divergence.turns[0].index), ("Token", expected.1));
            }
            if digests {
                continue;
            }
            // Two replays differ there in the field, with both values, if it is no function of the messages.
            let [one, two] = [(); 2].map(|()| says(&trace, (replayed, 17), digests, expected));
            let differs = one.differences(&two);
            match replayed {
                Leak::Hand => assert!(differs.is_empty(), "{differs:?}"),
                _ => {
                    assert!(
                        differs.iter().any(|d| d.path.ends_with("value")),
                        "{replayed:?}: {one} and {two}"
                    );
                    assert!(differs.iter().all(|d| d.left != d.right));
                }
            }
        }
    }
}
