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
    /// It says two things the other way round.
    Swap,
}

/// Passes tokens to its neighbour, each with another one that ends there; at one of them it leaks.
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
        if token.hops == 0 {
            return;
        }
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
            Some((Leak::Nothing | Leak::Swap, _)) | None => {}
        }
        if let Some(to) = &self.to {
            let swaps = matches!(self.leak, Some((Leak::Swap, at)) if at + 1 == cx.index());
            // One that goes on and one that ends there.
            let mut tokens = [(token.hops - 1, self.state), (0, !self.state)];
            if swaps {
                tokens.reverse();
            }
            for (hops, value) in tokens {
                cx.tell(to, Msg::Token(Token { hops, value })).expect("few tokens on their way");
            }
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
    let leaky = [(); 2].map(|()| wiring.declare::<Leaky>(Bounds::messages(16)));
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

/// Records a run in which `leaky-2` leaks.
fn recorded(leak: (Leak, u64), digests: bool) -> Arc<Trace> {
    recorded_under(Hashing::Said, leak, digests)
}

fn recorded_under(hashing: Hashing, leak: (Leak, u64), digests: bool) -> Arc<Trace> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("leaky.fvlog");
    let config = Config { hashing, ..Config::live(2).record(&path) };
    let (mut runtime, ()) = Runtime::build(config, |wiring| wire(wiring, leak, digests)).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    runtime.shutdown(WAIT);
    Arc::new(Trace::open(&path).expect("reads"))
}

/// How a replay parts from a recording.
fn parted(trace: &Arc<Trace>, leak: (Leak, u64), digests: bool, threads: usize) -> Divergence {
    let config = Config::replay(Arc::clone(trace), threads);
    let (mut runtime, ()) = Runtime::build(config, |wiring| wire(wiring, leak, digests)).expect("builds");
    runtime.replay().divergence.expect("it leaks")
}

/// What an actor said in a delivery of a replay that goes as recorded.
fn told(trace: &Arc<Trace>, leak: (Leak, u64), from: (ActorId, u64)) -> Vec<Content> {
    let found: Arc<SegQueue<Content>> = Arc::default();
    let sink = Arc::clone(&found);
    let observer: Observer = Arc::new(move |d: &Delivery<'_>| {
        if d.cause == Some(from) {
            sink.push((d.told)());
        }
    });
    let config = Config { observer: Some(observer), ..Config::replay(Arc::clone(trace), 0) };
    let (mut runtime, ()) = Runtime::build(config, |wiring| wire(wiring, leak, false)).expect("builds");
    assert_eq!(runtime.replay().divergence, None);
    std::iter::from_fn(|| found.pop()).collect()
}

/// 200 faults of five kinds, at as many places: each is named by its actor, its delivery and the field in which it shows,
/// with both values. What depends on something that is no message differs between two replays; what does not is told by
/// a replay of what was recorded, without the fault.
#[test]
fn what_an_actor_must_not_do_is_found_where_it_did() {
    let culprit = ActorId(1);
    let mut named = 0;
    let clean = recorded((Leak::Nothing, 0), false);
    for number in 0..40 {
        // Every other one ends there, and nothing is said to it.
        let at = 2 * (3 + number);
        for (was, now) in [
            (Leak::Clock, Leak::Clock),
            (Leak::Map, Leak::Map),
            (Leak::Float, Leak::Float),
            (Leak::Nothing, Leak::Hand),
            (Leak::Nothing, Leak::Swap),
        ] {
            let same = matches!(was, Leak::Nothing);
            // With the state's own hash, and without.
            let digests = number % 4 == 0 && !same;
            let attempt = || {
                let trace = if same { Arc::clone(&clean) } else { recorded((was, at), digests) };
                let parted = [0, 2].map(|threads| parted(&trace, (now, at), digests, threads));
                (trace, parted)
            };
            let is_named = |d: &Divergence| (d.actor, d.index) == (culprit, at);
            // A recording keeps 16 bits of each hash, so of 65,536 values of chance one passes as another, which shows only
            // in what follows from it. Not twice.
            let (trace, [one, two]) = match attempt() {
                again if !same && !again.1.iter().all(is_named) => attempt(),
                found => found,
            };
            for divergence in [&one, &two] {
                assert_eq!((divergence.actor, divergence.index), (culprit, at), "{now:?}: {divergence}");
                assert_eq!((divergence.kind, divergence.turns[0].index), ("Token", at));
                assert_eq!(divergence.said.as_ref().map(Vec::len), Some(2), "{divergence}");
            }
            let says =
                |of: &Divergence| of.said.iter().flatten().map(|said| said.says.clone()).collect::<Vec<_>>();
            let (left, right) = match same {
                true => (told(&trace, (was, at), (culprit, at)), says(&one)),
                false => (says(&one), says(&two)),
            };
            assert_eq!(left.len(), right.len());
            let differs: Vec<Difference> =
                left.iter().zip(&right).flat_map(|(left, right)| left.differences(right)).collect();
            assert!(differs.iter().all(|d| d.left != d.right));
            named += u32::from(differs.iter().any(|d| d.path.ends_with("value")));
        }
    }
    assert_eq!(named, 200);
}

/// Under every kind of hash, and before anybody is told it.
#[test]
fn what_is_said_in_a_delivery_can_be_listened_to() {
    let (culprit, at) = (ActorId(1), 40);
    for hashing in [Hashing::Said, Hashing::Exact, Hashing::Every(64), Hashing::Off] {
        let trace = recorded_under(hashing, (Leak::Nothing, 0), false);
        for threads in [0, 2] {
            let until = Some(Until::Delivery { actor: culprit, index: at });
            let mode = Mode::Replay { trace: Arc::clone(&trace), until };
            let config = Config { mode, listen_to: Some((culprit, at)), ..Config::live(threads) };
            let (mut runtime, ()) =
                Runtime::build(config, |wiring| wire(wiring, (Leak::Nothing, 0), false)).expect("builds");
            runtime.pump(Limit::IDLE);
            assert_eq!(runtime.replay_report().divergence, None);
            let heard: Vec<Content> =
                runtime.heard().expect("it comes there").iter().map(|said| said.says.clone()).collect();
            assert_eq!(heard.len(), 2);
            assert_eq!(heard, told(&trace, (Leak::Nothing, 0), (culprit, at)), "{hashing:?}");
            // And it goes on.
            runtime.resume(None);
            assert_eq!(runtime.replay().divergence, None, "{hashing:?}");
        }
    }
}
