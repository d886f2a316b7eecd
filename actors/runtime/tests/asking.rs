//! Questions and answers: in time, late, twice, refused; recorded, replayed, simulated.

use foveal_runtime::simulate::Simulation;
use foveal_runtime::*;
use std::sync::Arc;
use std::time::Duration;

use crate::common::*;

#[derive(Message)]
#[message(unsaved = "an address is not read back from a snapshot")]
enum OracleMsg {
    Question { number: u64, ticket: Ticket, reply_to: Address<AskerMsg> },
    Reply { number: u64, ticket: Ticket, reply_to: Address<AskerMsg> },
}

#[derive(Message)]
enum AskerMsg {
    Go,
    Answer { square: u64, ticket: Ticket },
    Late(Ticket),
}

/// Answers some questions at once, some twice, some an hour later, and some never.
struct Oracle;

impl Actor for Oracle {
    type Msg = OracleMsg;
    const NAME: &'static str = "oracle";

    fn handle(&mut self, message: OracleMsg, cx: &mut Cx<'_, OracleMsg>) {
        match message {
            OracleMsg::Question { number, ticket, reply_to } => match number % 4 {
                0 | 1 => {
                    for _ in 0..=number % 4 {
                        cx.tell(&reply_to, AskerMsg::Answer { square: number * number, ticket })
                            .expect("room");
                    }
                }
                2 => {
                    let reply = OracleMsg::Reply { number, ticket, reply_to };
                    cx.after(Duration::from_millis(30), reply).expect("a timer");
                }
                _ => {}
            },
            OracleMsg::Reply { number, ticket, reply_to } => {
                cx.tell(&reply_to, AskerMsg::Answer { square: number * number, ticket }).expect("room");
            }
        }
    }
}

#[derive(Default)]
struct Asked {
    open: Vec<(Ticket, u64)>,
    answers: Vec<u64>,
    late: Vec<u64>,
    ignored: u32,
    refused: u64,
}

struct Asker {
    oracle: Address<OracleMsg>,
    questions: u64,
    asked: Asked,
}

impl Asker {
    fn close(&mut self, ticket: Ticket) -> u64 {
        let at = self.asked.open.iter().position(|(open, _)| *open == ticket).expect("it is open");
        self.asked.open.swap_remove(at).1
    }
}

impl Actor for Asker {
    type Msg = AskerMsg;
    const NAME: &'static str = "asker";

    fn started(&mut self, cx: &mut Cx<'_, AskerMsg>) {
        let me = cx.address().clone();
        cx.tell(&me, AskerMsg::Go).expect("room");
    }

    fn handle(&mut self, message: AskerMsg, cx: &mut Cx<'_, AskerMsg>) {
        match message {
            AskerMsg::Go => {
                for number in 0..self.questions {
                    let reply_to = cx.address().clone();
                    let question = |ticket| OracleMsg::Question { number, ticket, reply_to };
                    match cx.ask(&self.oracle.clone(), Duration::from_millis(10), question, AskerMsg::Late) {
                        Ok(ticket) => self.asked.open.push((ticket, number)),
                        Err(_) => self.asked.refused += 1,
                    }
                }
            }
            AskerMsg::Answer { square, ticket } => {
                if cx.answered(ticket) {
                    assert_eq!(self.close(ticket).pow(2), square);
                    self.asked.answers.push(square);
                } else {
                    self.asked.ignored += 1;
                }
            }
            AskerMsg::Late(ticket) => {
                let number = self.close(ticket);
                self.asked.late.push(number);
            }
        }
        let Asked { open, answers, late, ignored, refused } = &self.asked;
        let counts = [open.len(), answers.len(), late.len(), *ignored as usize, *refused as usize];
        cx.mark(0, counts.into_iter().fold(0, |sum, count| sum * 100 + count as u64));
    }
}

fn wire(wiring: &mut Wiring, questions: u64, room: usize) -> Handle<Asker> {
    let oracle = wiring.declare::<Oracle>(Bounds::messages(room));
    let asker = wiring.declare::<Asker>(Bounds::messages(64));
    let asker = wiring.spawn(
        asker,
        Asker { oracle: oracle.address(), questions, asked: Asked::default() },
        OnPanic::End,
    );
    wiring.spawn(oracle, Oracle, OnPanic::End);
    asker
}

/// Every question is answered or late, once.
#[track_caller]
fn check(asked: &Asked, questions: u64) {
    assert_eq!(asked.open, []);
    assert_eq!(asked.answers.len() as u64 + asked.late.len() as u64 + asked.refused, questions);
}

#[test]
fn answers_count_once_and_in_time() {
    for seed in 0..200 {
        let (mut runtime, asker) =
            Runtime::build(Config::simulate(Simulation::new(seed)), |wiring| wire(wiring, 8, 16))
                .expect("builds");
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
        assert_eq!(runtime.failure(), None);
        let checked = runtime.inspect(asker, |asker| {
            check(&asker.asked, 8);
            // Never answered, or 20 ms too late.
            assert!([2, 3, 6, 7].iter().all(|number| asker.asked.late.contains(number)), "seed {seed}");
            assert_eq!(asker.asked.refused, 0);
        });
        assert!(checked.is_some());
    }
}

#[test]
fn a_refused_question_leaves_no_timer_behind() {
    let (mut runtime, asker) =
        Runtime::build(Config::simulate(Simulation::new(1)), |wiring| wire(wiring, 20, 4)).expect("builds");
    assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
    let refused = runtime.inspect(asker, |asker| {
        check(&asker.asked, 20);
        asker.asked.refused
    });
    assert_eq!(refused, Some(16));
}

#[test]
fn questions_replay() {
    for threads in [0, 2] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("asked.fvlog");
        let config = Config::live(threads).record(&path);
        let (mut runtime, _) = Runtime::build(config, |wiring| wire(wiring, 20, 8)).expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        runtime.shutdown(WAIT);
        let trace = Arc::new(Trace::open(&path).expect("reads"));
        for threads in [0, 2] {
            let (mut runtime, _) =
                Runtime::build(Config::replay(trace.clone(), threads), |wiring| wire(wiring, 20, 8))
                    .expect("builds");
            assert_complete(&runtime.replay());
        }
    }
}
