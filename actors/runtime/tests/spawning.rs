//! Actors that come while the system runs.

use foveal_runtime::simulate::{FaultKind, Faults, Simulation};
use foveal_runtime::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

use crate::common::{WAIT, assert_complete};

/// A guest is at the door, who will say so many words.
#[derive(Serialize, Deserialize)]
struct Arrival {
    words: u32,
}

#[derive(Message)]
enum HostMsg {
    Arrival { words: u32 },
    Said { guest: u32, word: u32 },
}

impl From<Arrival> for HostMsg {
    fn from(Arrival { words }: Arrival) -> Self {
        Self::Arrival { words }
    }
}

/// Gives guests their places and listens to them.
struct Host {
    places: Reserve<Guest>,
    came: u32,
    turned_away: u32,
    heard: Vec<(u32, u32)>,
}

impl Actor for Host {
    type Msg = HostMsg;
    const NAME: &'static str = "host";

    fn handle(&mut self, message: HostMsg, cx: &mut Cx<'_, HostMsg>) {
        match message {
            HostMsg::Arrival { words } => {
                let guest = Guest { number: self.came, host: cx.address().clone(), said: 0 };
                // A guest of 13 words does not survive the 13th, and begins again.
                let (number, host) = (self.came, cx.address().clone());
                let again = OnPanic::restart(move || Guest { number, host: host.clone(), said: 100 });
                match cx.spawn(&mut self.places, guest, again) {
                    Ok(guest) => {
                        self.came += 1;
                        for _ in 0..words {
                            cx.tell(&guest, GuestMsg::Speak).expect("room");
                        }
                        cx.tell(&guest, GuestMsg::Leave).expect("room");
                    }
                    Err(guest) => self.turned_away += u32::from(guest.number == self.came),
                }
            }
            HostMsg::Said { guest, word } => self.heard.push((guest, word)),
        }
    }
}

#[derive(Message)]
enum GuestMsg {
    Speak,
    Leave,
}

struct Guest {
    number: u32,
    host: Address<HostMsg>,
    said: u32,
}

impl Actor for Guest {
    type Msg = GuestMsg;
    const NAME: &'static str = "guest";

    fn started(&mut self, cx: &mut Cx<'_, GuestMsg>) {
        cx.tell(&self.host, HostMsg::Said { guest: self.number, word: 0 }).expect("room");
    }

    fn handle(&mut self, message: GuestMsg, cx: &mut Cx<'_, GuestMsg>) {
        match message {
            GuestMsg::Speak => {
                self.said += 1;
                if self.said == 13 {
                    std::panic::resume_unwind(Box::new("the thirteenth word"));
                }
                cx.tell(&self.host, HostMsg::Said { guest: self.number, word: self.said }).expect("room");
            }
            GuestMsg::Leave => cx.stop(),
        }
    }
}

struct House {
    host: Handle<Host>,
    door: Port<Arrival, HostMsg>,
    guests: Vec<Handle<Guest>>,
}

fn wire(wiring: &mut Wiring) -> House {
    let host = wiring.declare::<Host>(Bounds::messages(1000));
    let door = wiring.port::<Arrival, HostMsg>("door", &host.address());
    let places = wiring.reserve::<Guest>(3, Bounds::messages(100));
    let guests = places.handles();
    assert_eq!((places.len(), places.is_empty()), (3, false));
    let state = Host { places, came: 0, turned_away: 0, heard: Vec::new() };
    House { host: wiring.spawn(host, state, OnPanic::End), door, guests }
}

/// Two guests of few words, one of many, and one too many.
fn receive(house: &House) {
    for words in [2, 5, 20, 1] {
        house.door.send(Arrival { words }).expect("room");
    }
}

/// What each guest was heard to say, in order.
fn heard(host: &Host) -> [Vec<u32>; 3] {
    let of = |guest| host.heard.iter().filter(|(who, _)| *who == guest).map(|(_, word)| *word).collect();
    [of(0), of(1), of(2)]
}

fn expected() -> [Vec<u32>; 3] {
    // The third begins anew after twelve words, and the thirteenth is lost.
    let third = (0..=12).chain(101..=107).collect();
    [(0..=2).collect(), (0..=5).collect(), third]
}

#[test]
fn guests_come_while_the_system_runs_and_a_replay_receives_them_alike() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("house.fvlog");
    for threads in [0, 1, 3] {
        let config = Config::live(threads).record(&path);
        let (mut runtime, house) = Runtime::build(config, wire).expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle, "empty places are at rest");
        receive(&house);
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let end = runtime.end(WAIT);
        assert!(end.drained && end.dead_letters == 1, "{end:?}");
        let told = runtime.inspect(house.host, |host| (heard(host), host.came, host.turned_away));
        assert_eq!(told, Some((expected(), 3, 1)), "{threads} threads");
        assert_eq!(runtime.inspect(house.guests[2], |guest| guest.said), Some(107));
        drop(runtime);
        let trace = Arc::new(Trace::open(&path).expect("reads"));
        for again in [0, 2] {
            let config = Config::replay(Arc::clone(&trace), again);
            let (mut runtime, house) = Runtime::build(config, wire).expect("builds");
            assert_complete(&runtime.replay());
            if again == 0 {
                assert_eq!(runtime.inspect(house.host, heard), Some(expected()));
            }
        }
    }
}

#[test]
fn nobody_comes_and_the_system_ends_as_ever() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("house.fvlog");
    let (mut runtime, house) = Runtime::build(Config::live(1).record(&path), wire).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    let end = runtime.end(WAIT);
    assert!(end.drained && end.dead_letters == 0, "{end:?}");
    assert_eq!(runtime.inspect(house.guests[0], |guest| guest.said), None);
    drop(runtime);
    let trace = Arc::new(Trace::open(&path).expect("reads"));
    let (mut runtime, _) = Runtime::build(Config::replay(trace, 0), wire).expect("builds");
    assert_complete(&runtime.replay());
}

#[test]
fn guests_come_under_any_schedule() {
    for seed in 0..300 {
        let kinds = vec![FaultKind::Delay, FaultKind::Stall, FaultKind::Slow];
        let faults = Faults::Seeded { kinds, each: 2, horizon: 20 };
        let run = || {
            let simulation = Simulation { faults: faults.clone(), ..Simulation::new(seed) };
            let (mut runtime, house) = Runtime::build(Config::simulate(simulation), wire).expect("builds");
            receive(&house);
            assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle, "{:?}", runtime.failure());
            assert_eq!(runtime.inspect(house.host, heard), Some(expected()), "seed {seed}");
            runtime.fingerprint()
        };
        assert_eq!(run(), run(), "seed {seed}");
    }
}
