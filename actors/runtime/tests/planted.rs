//! Actors that do what an actor must not are found by replay at the very message where they did.

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
            None => {}
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

#[test]
fn a_clock_and_a_random_map_are_found_at_their_message() {
    let folder = tempfile::tempdir().expect("a folder");
    for (number, leak) in [Leak::Clock, Leak::Map].into_iter().enumerate() {
        for digests in [true, false] {
            let path = folder.path().join(format!("{number}-{digests}.fvlog"));
            let config = Config::live(2).record(&path);
            let (mut runtime, ()) =
                Runtime::build(config, |wiring| wire(wiring, (leak, 17), digests)).expect("builds");
            assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
            runtime.shutdown(WAIT);
            let trace = Arc::new(Trace::open(&path).expect("reads"));
            for threads in [0, 2] {
                let config = Config::replay(trace.clone(), threads);
                let (mut runtime, ()) =
                    Runtime::build(config, |wiring| wire(wiring, (leak, 17), digests)).expect("builds");
                let divergence = runtime.replay().divergence.expect("it leaks");
                // With the state's hash it is the message itself; without, the first that tells of it.
                let expected = if digests { (ActorId(1), 17) } else { (ActorId(0), 18) };
                assert_eq!((divergence.actor, divergence.index), expected, "{leak:?}: {divergence}");
                assert_eq!((divergence.kind, divergence.turns[0].index), ("Token", expected.1));
            }
        }
    }
}
