//! The hub alone: viewers and walks are played, time is a number.

use foveal::image::Map2d;
use foveal::scene::Display;
use foveal_actors::renderer::overlay::Overlay;
use foveal_actors::settings::{Adjustment, Settings};
use foveal_engine::change::Change;
use foveal_engine::controls::Value;
use foveal_engine::foveal::scene::Camera;
use foveal_engine::glam::Vec3;
use foveal_engine::navigation::Motion;
use foveal_engine::source::{Controls, NamedLamp, Status};
use foveal_engine::thread::Report;
use foveal_engine::walk::Act;
use foveal_engine::{Lamp, SceneEdit};
use proptest::prelude::*;
use serde_json::json;

use super::*;
use crate::coding::encode;
use crate::protocol::VERSION;

const LIMITS: Limits = Limits { walks: None, viewers: 4, bytes: None, idle: 60.0 };

/// A server that is played.
struct Played {
    hub: Hub,
    now: f64,
    token: String,
    watch: String,
    room: RoomId,
}

impl Played {
    fn new(limits: Limits) -> Self {
        let [drive, watch] = [(); 2].map(|()| Token::random().expect("a token"));
        let (token, watching) = (drive.as_str().to_owned(), watch.as_str().to_owned());
        let mut hub = Hub::new(limits, Gate::new(drive, Some(watch)));
        let room = if limits.walks.is_none() { hub.open(Described::default(), 0.0) } else { 0 };
        Self { hub, now: 0.0, token, watch: watching, room }
    }

    fn on(&mut self, event: Event) -> Vec<Effect> {
        self.hub.on(event, self.now)
    }

    fn say(&mut self, id: ViewerId, message: serde_json::Value) -> Vec<Effect> {
        self.on(Event::Text(id, message.to_string()))
    }

    fn connect(&mut self, id: ViewerId) {
        let address = IpAddr::from([192, 0, 2, id as u8]);
        assert!(self.on(Event::Connected(id, address)).is_empty());
    }

    fn enter(&mut self, id: ViewerId, token: &str, resume: Option<&str>) -> Vec<Effect> {
        self.connect(id);
        self.say(id, json!({"type": "hello", "v": VERSION, "token": token, "resume": resume}))
    }

    /// Somebody with the first token comes.
    fn driver(&mut self, id: ViewerId) -> Vec<Effect> {
        let token = self.token.clone();
        self.enter(id, &token, None)
    }

    fn shows(&mut self, shown: &Arc<Shown>) -> Vec<Effect> {
        let room = self.room;
        self.on(Event::Shown(room, Arc::clone(shown)))
    }

    /// Has everything coded that is to be; all effects, in order.
    fn coded(&mut self, effects: Vec<Effect>) -> Vec<Effect> {
        let mut waiting = std::collections::VecDeque::from(effects);
        let mut done = Vec::new();
        while let Some(effect) = waiting.pop_front() {
            if let Effect::Code(order) = &effect {
                let before = order.before.as_ref().map(|b| &*b.picture);
                let coded = encode(&order.shown.picture, before, order.coding);
                waiting.extend(self.on(Event::Coded(order.clone(), coded)));
            }
            done.push(effect);
        }
        done
    }
}

fn report() -> Arc<Report> {
    let set = Adjustment::of(&Settings::new(64, 48, 1), &Display::default());
    Arc::new(Report {
        controls: Controls { set, overlay: Overlay::None },
        status: Status::default(),
        times: None,
        quality: None,
        speed: 1.0,
        orbits: false,
        insight: None,
        timeline: None,
    })
}

/// A picture of one colour.
fn shown(number: u64, exact: bool) -> Arc<Shown> {
    let camera = Camera { eye: Vec3::ZERO, target: Vec3::NEG_Z, up: Vec3::Y, fov_y: 1.0 };
    let picture = Arc::new(Map2d::new(64, 48, [number as u8; 3]));
    Arc::new(Shown {
        number,
        picture,
        camera: Some(camera),
        took: 0.0,
        mark: Some(7.5),
        exact,
        set: 0,
        moving: false,
        report: report(),
    })
}

fn texts(effects: &[Effect], to: ViewerId) -> Vec<serde_json::Value> {
    let of = |effect: &Effect| match effect {
        Effect::Text(id, text, _) if *id == to => serde_json::from_str(text).ok(),
        _ => None,
    };
    effects.iter().filter_map(of).collect()
}

fn one(effects: &[Effect], to: ViewerId, kind: &str) -> serde_json::Value {
    let found: Vec<_> = texts(effects, to).into_iter().filter(|text| text["type"] == kind).collect();
    assert_eq!(found.len(), 1, "{kind} for {to} in {effects:?}");
    found.into_iter().next().expect("one")
}

fn frames(effects: &[Effect], to: ViewerId) -> Vec<&[u8]> {
    effects
        .iter()
        .filter_map(|effect| match effect {
            Effect::Binary(id, bytes) if *id == to => Some(bytes.as_slice()),
            _ => None,
        })
        .collect()
}

fn closed(effects: &[Effect], id: ViewerId) -> Option<Why> {
    effects.iter().find_map(|effect| match effect {
        Effect::Close(who, why) if *who == id => Some(*why),
        _ => None,
    })
}

fn told(effects: &[Effect]) -> Vec<&Command> {
    fn command(effect: &Effect) -> Option<&Command> {
        if let Effect::Tell(_, command) = effect { Some(command) } else { None }
    }
    effects.iter().filter_map(command).collect()
}

/// Events of input: time in ms, kind, two numbers.
fn input(events: &[(f64, u8, f32, f32)]) -> Vec<u8> {
    let bytes = |(time, kind, a, b): &(f64, u8, f32, f32)| {
        [&time.to_le_bytes()[..], &[*kind], &a.to_le_bytes(), &b.to_le_bytes()].concat()
    };
    events.iter().flat_map(bytes).collect()
}

#[test]
fn whoever_has_no_right_is_told_why_and_sees_nothing() {
    let mut played = Played::new(LIMITS);
    played.shows(&shown(1, true));
    let token = played.token.clone();
    let cases = [
        (json!({"type": "hello", "v": VERSION, "token": "guess"}), Why::Token),
        (json!({"type": "hello", "v": VERSION + 1, "token": token}), Why::Version),
        (json!({"type": "hello"}), Why::Rude),
        (json!({"type": "shown", "frame": 1}), Why::Rude),
        (json!({"type": "do", "name": "take"}), Why::Rude),
    ];
    for (id, (message, why)) in cases.into_iter().enumerate() {
        played.connect(id as u64);
        let effects = played.say(id as u64, message);
        assert_eq!(closed(&effects, id as u64), Some(why));
        assert_eq!(one(&effects, id as u64, "bye")["why"], json!(why));
        assert!(frames(&effects, id as u64).is_empty() && told(&effects).is_empty());
    }
    // Who says nothing has five seconds.
    played.connect(9);
    played.now = 4.0;
    assert_eq!(closed(&played.on(Event::Tick), 9), None);
    played.now = 5.1;
    assert_eq!(closed(&played.on(Event::Tick), 9), Some(Why::Idle));
    // One at a time.
    played.connect(10);
    assert_eq!(closed(&played.on(Event::Input(10, input(&[(0.0, 6, 0.0, 0.0)]))), 10), Some(Why::Rude));
}

#[test]
fn a_viewer_has_two_frames_on_the_way_and_gets_the_newest() {
    let mut played = Played::new(LIMITS);
    let welcome = played.driver(1);
    assert_eq!(one(&welcome, 1, "welcome")["role"], "drives");
    let mut sent = Vec::new();
    for number in 1..=10 {
        let effects = played.shows(&shown(number, false));
        let effects = played.coded(effects);
        sent.extend(frames(&effects, 1).iter().map(|f| u32::from_le_bytes([f[4], f[5], f[6], f[7]])));
    }
    assert_eq!(sent, [1, 2], "nobody has drawn them");
    let effects = played.say(1, json!({"type": "shown", "frame": 1}));
    let effects = played.coded(effects);
    assert_eq!(frames(&effects, 1)[0][4], 10, "the newest, not the next");
    // Who says nonsense about frames gains nothing.
    for frame in [0, 1, 77] {
        let effects = played.say(1, json!({"type": "shown", "frame": frame}));
        assert!(played.coded(effects).iter().all(|e| !matches!(e, Effect::Binary(..))));
    }
}

#[test]
fn a_still_picture_is_sent_once_without_loss_and_then_nothing() {
    let mut played = Played::new(LIMITS);
    played.driver(1);
    let picture = shown(1, true);
    let effects = played.shows(&picture);
    let first = played.coded(effects);
    assert_eq!(frames(&first, 1)[0][1], 1, "exact where it was made, not here");
    played.now = 0.2;
    let effects = played.on(Event::Tick);
    assert!(played.coded(effects).is_empty());
    played.now = 0.3;
    let effects = played.on(Event::Tick);
    let still = played.coded(effects);
    let frame = frames(&still, 1)[0];
    assert_eq!(frame[1], 3);
    let decoded = image::load_from_memory(&frame[protocol::HEAD_BYTES..]).expect("a picture").to_rgb8();
    assert_eq!(decoded.as_raw().as_slice(), picture.picture.data().as_flattened());
    for _ in 0..100 {
        played.now += 0.1;
        let effects = played.on(Event::Tick);
        assert!(frames(&played.coded(effects), 1).is_empty());
    }
}

#[test]
fn a_stalled_viewer_costs_the_others_nothing() {
    let mut played = Played::new(LIMITS);
    for id in 1..=3 {
        played.driver(id);
    }
    let mut seen = [0; 4];
    for number in 1..=50 {
        played.now += 0.1;
        let effects = played.shows(&shown(number, false));
        let effects = played.coded(effects);
        assert!(effects.iter().filter(|e| matches!(e, Effect::Code(_))).count() <= 2);
        for id in 1..=3 {
            for frame in frames(&effects, id) {
                seen[id as usize] += 1;
                // The first draws nothing.
                if id > 1 {
                    let answer = json!({"type": "shown", "frame": u32::from(frame[4])});
                    let more = played.say(id, answer);
                    assert!(frames(&more, 1).is_empty());
                }
            }
        }
    }
    assert_eq!(seen, [0, 2, 50, 50]);
}

#[test]
fn the_driver_s_input_reaches_the_walk_with_its_times_and_nobody_else_s() {
    let mut played = Played::new(LIMITS);
    played.driver(1);
    let watcher = played.driver(2);
    assert_eq!(one(&watcher, 2, "welcome")["role"], "watches");
    played.now = 10.0;
    let bytes = input(&[(1000.0, 1, 0.0, 0.0), (1100.0, 3, 5.0, 0.0), (1150.0, 2, 0.0, 0.0)]);
    let effects = played.on(Event::Input(1, bytes.clone()));
    let acts: Vec<(Act, f64, f64)> = told(&effects)
        .into_iter()
        .map(|command| match command {
            Command::Act { act, at, mark } => (*act, (*at * 1e3).round() / 1e3, *mark),
            other => panic!("{other:?}"),
        })
        .collect();
    let expected = [
        (Act::Press(Motion::Forward), 9.85, 1000.0),
        (Act::Look(5.0, 0.0), 9.95, 1100.0),
        (Act::Release(Motion::Forward), 10.0, 1150.0),
    ];
    assert_eq!(acts, expected);
    assert!(told(&played.on(Event::Input(2, bytes))).is_empty());
    let set = json!({"type": "set", "key": "exposure", "value": 1.0});
    assert!(told(&played.say(2, set.clone())).is_empty());
    let command = Command::Put { key: "exposure".into(), value: Value::Number(1.0) };
    assert_eq!(told(&played.say(1, set)), [&command]);
    // Whoever drove is gone: keys go up.
    let effects = played.on(Event::Gone(1));
    assert!(matches!(told(&effects)[..], [Command::Act { act: Act::ReleaseAll, .. }]));
}

/// The same, once the walk has done so many commands that set something.
fn after(number: u64, set: u64) -> Arc<Shown> {
    Arc::new(Shown { set, ..(*shown(number, true)).clone() })
}

#[test]
fn nothing_is_exact_before_it_has_what_was_set() {
    let mut played = Played::new(LIMITS);
    played.driver(1);
    played.driver(2);
    let still = |effects: &[Effect], id| {
        texts(effects, id).into_iter().rfind(|text| text["type"] == "still").map(|text| {
            (text["picture"].as_u64(), text["exact"].as_bool().expect("a word"), text["set"].as_u64())
        })
    };
    let effects = played.shows(&after(1, 0));
    assert_eq!(still(&effects, 1), Some((Some(1), true, Some(0))));
    played.coded(effects);
    played.now = 0.3;
    let effects = played.on(Event::Tick);
    assert_eq!(frames(&played.coded(effects), 1)[0][1], 3);
    // It is said at once, to all, that it is so no more.
    let effects = played.say(1, json!({"type": "set", "key": "fps", "value": 5}));
    assert_eq!(still(&effects, 1), Some((Some(1), false, Some(1))));
    assert_eq!(still(&effects, 2), Some((Some(1), false, Some(0))));
    // What was shown before does not count; what was shown since does, without being sent again.
    assert_eq!(still(&played.shows(&after(1, 0)), 1), None);
    let effects = played.shows(&after(1, 1));
    assert_eq!(still(&effects, 1), Some((Some(1), true, Some(1))));
    played.now = 2.0;
    let effects = played.on(Event::Tick);
    assert!(frames(&played.coded(effects), 1).is_empty());
    // Of who may not set anything the words are counted and do nothing.
    let effects = played.say(2, json!({"type": "do", "name": "reload"}));
    assert_eq!((still(&effects, 2), told(&effects)), (Some((Some(1), true, Some(1))), vec![]));
}

#[test]
fn a_walk_is_changed_within_bounds() {
    let mut played = Played::new(LIMITS);
    let lamp = |lamp| NamedLamp { name: "a".into(), lamp, gain: Vec3::ONE };
    let lamps = vec![lamp(Lamp::Material(4)), lamp(Lamp::Light(2))];
    played.driver(1);
    let mut described = Described::default();
    described.lamps = lamps;
    let room = played.room;
    let effects = played.on(Event::Described(room, described));
    assert_eq!(one(&effects, 1, "welcome")["lamps"][1]["moves"], true);
    played.shows(&shown(1, true));
    let edit = |edit| Some(Command::Change(Change::Edit(edit)));
    let moved = SceneEdit::LightMoved { light: 2, position: Vec3::ZERO, direction: Vec3::NEG_Z };
    let dimmed = SceneEdit::LampDimmed { lamp: Lamp::Material(4), gain: Vec3::splat(0.5) };
    for (deed, expected) in [
        (json!({"name": "size", "width": 640, "height": 16}), Some(Command::Change(Change::Size([640, 16])))),
        (json!({"name": "size", "width": 15, "height": 100}), None),
        (json!({"name": "size", "width": 100, "height": 4097}), None),
        (json!({"name": "reload"}), Some(Command::Change(Change::Reload))),
        (json!({"name": "dim", "lamp": 0, "gain": 0.5}), edit(dimmed)),
        (json!({"name": "dim", "lamp": 0, "gain": -1}), None),
        (json!({"name": "dim", "lamp": 2, "gain": 1}), None),
        (json!({"name": "bring", "lamp": 1}), edit(moved)),
        (json!({"name": "bring", "lamp": 0}), None),
    ] {
        played.now += 1.0;
        let mut message = deed.clone();
        message["type"] = json!("do");
        let effects = played.say(1, message);
        assert_eq!(told(&effects).first().copied(), expected.as_ref(), "{deed}");
        let notices = texts(&effects, 1).iter().filter(|text| text["type"] == "notice").count();
        assert_eq!(notices, usize::from(expected.is_none()), "{deed}");
    }
}

#[test]
fn a_server_that_began_anew_goes_on_where_the_page_was() {
    let camera = Camera { eye: Vec3::ONE, target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.0 };
    let numbers = protocol::camera_numbers(&camera);
    let hello = |token: &str| json!({"type": "hello", "v": VERSION, "token": token, "resume": "unknown", "camera": numbers});
    let mut played = Played::new(LIMITS);
    let token = played.token.clone();
    played.connect(1);
    let effects = played.say(1, hello(&token));
    let stands = Command::Act { act: Act::Stand(camera), at: 0.0, mark: 0.0 };
    assert!(told(&effects).contains(&&stands));
    assert!(one(&effects, 1, "notice")["text"].as_str().is_some_and(|text| text.contains("begun anew")));
    // Once; and not where somebody walks already.
    played.on(Event::Gone(1));
    played.connect(2);
    assert!(!told(&played.say(2, hello(&token))).contains(&&stands));
    // A walk of one's own is told when it stands.
    let mut played = Played::new(Limits { walks: Some(2), ..LIMITS });
    let token = played.token.clone();
    played.connect(1);
    let effects = played.say(1, hello(&token));
    assert!(told(&effects).is_empty());
    let effects = played.on(Event::Opened(0, Ok(Described::default())));
    assert_eq!(told(&effects), [&stands]);
}

#[test]
fn driving_is_taken_when_nobody_minds() {
    let mut played = Played::new(LIMITS);
    played.driver(1);
    played.driver(2);
    let watch = played.watch.clone();
    let welcome = played.enter(3, &watch, None);
    assert_eq!(one(&welcome, 3, "welcome")["may_drive"], false);
    // Who may only look asks in vain.
    let take = json!({"type": "do", "name": "take"});
    assert!(texts(&played.say(3, take.clone()), 1).is_empty());
    // A driver at work is asked.
    played.now = 1.0;
    played.on(Event::Input(1, input(&[(0.0, 3, 1.0, 0.0)])));
    let effects = played.say(2, take.clone());
    assert_eq!(one(&effects, 1, "role")["asked"], true);
    assert!(texts(&effects, 2).iter().all(|text| text["role"] != "drives"));
    let effects = played.say(1, json!({"type": "do", "name": "give"}));
    assert_eq!(
        (&one(&effects, 2, "role")["role"], &one(&effects, 1, "role")["role"]),
        (&json!("drives"), &json!("watches"))
    );
    // Keys that were held go up.
    assert!(matches!(told(&effects)[..], [Command::Act { act: Act::ReleaseAll, .. }]));
    // Who only sits there is not asked.
    played.now = 12.0;
    assert_eq!(one(&played.say(1, take), 1, "role")["role"], "drives");
    // Nobody gives what they have not.
    assert!(told(&played.say(2, json!({"type": "do", "name": "give"}))).is_empty());
}

#[test]
fn who_comes_back_drives_again() {
    let mut played = Played::new(LIMITS);
    let welcome = played.driver(1);
    let resume = one(&welcome, 1, "welcome")["resume"].as_str().expect("a word").to_owned();
    played.driver(2);
    // By another connection, before the first was missed.
    let token = played.token.clone();
    let effects = played.enter(3, &token, Some(&resume));
    assert_eq!(closed(&effects, 1), Some(Why::Elsewhere));
    assert_eq!(one(&effects, 3, "welcome")["role"], "drives");
    // After it was lost: nobody drove meanwhile, since nobody asked.
    let again = one(&effects, 3, "welcome")["resume"].as_str().expect("a word").to_owned();
    assert_ne!(again, resume);
    played.on(Event::Gone(3));
    played.now = 30.0;
    let effects = played.enter(4, &token, Some(&again));
    assert_eq!(one(&effects, 4, "welcome")["role"], "drives");
}

#[test]
fn a_walk_without_viewers_pauses_and_goes_on() {
    let mut played = Played::new(LIMITS);
    played.driver(1);
    played.now = 100.0;
    assert!(told(&played.on(Event::Tick)).is_empty());
    played.on(Event::Gone(1));
    played.now = 109.0;
    assert!(told(&played.on(Event::Tick)).is_empty());
    played.now = 111.0;
    assert_eq!(told(&played.on(Event::Tick)), [&Command::Pause]);
    played.now = 112.0;
    assert!(told(&played.on(Event::Tick)).is_empty(), "once");
    assert_eq!(told(&played.driver(2)), [&Command::Resume]);
}

#[test]
fn there_are_no_more_viewers_than_are_let_in_and_silent_ones_go() {
    let mut played = Played::new(LIMITS);
    for id in 0..4 {
        assert_eq!(closed(&played.driver(id), id), None);
    }
    assert_eq!(closed(&played.driver(4), 4), Some(Why::Full));
    played.now = 500.0;
    played.say(2, json!({"type": "here"}));
    played.now = 700.0;
    let effects = played.on(Event::Tick);
    assert_eq!(closed(&effects, 0), Some(Why::Idle));
    assert_eq!(closed(&effects, 2), None);
}

#[test]
fn who_sends_too_much_is_closed() {
    let mut played = Played::new(LIMITS);
    let look = input(&[(0.0, 3, 1.0, 0.0)]);
    let floods: [Box<dyn Fn() -> Event>; 5] = [
        Box::new(move || Event::Input(0, look.clone())),
        Box::new(|| Event::Input(1, input(&[(0.0, 6, 0.0, 0.0); 400]))),
        Box::new(|| Event::Text(2, json!({"type": "set", "key": "fps", "value": 1}).to_string())),
        Box::new(|| Event::Text(3, json!({"type": "do", "name": "play"}).to_string())),
        Box::new(|| Event::Text(4, format!("{{\"type\":\"here\",\"x\":\"{}\"}}", "y".repeat(TEXT_MAX)))),
    ];
    for (id, flood) in floods.iter().enumerate() {
        played.driver(id as u64);
        let end = (0..300).find_map(|_| closed(&played.on(flood()), id as u64));
        assert_eq!(end, Some(Why::Rude), "{id}");
    }
}

#[test]
fn each_has_a_walk_while_there_are_any() {
    let limits = Limits { walks: Some(2), ..LIMITS };
    let mut played = Played::new(limits);
    let opens = |effects: &[Effect]| {
        effects.iter().find_map(|e| if let Effect::Open(room) = e { Some(*room) } else { None })
    };
    let effects = played.driver(1);
    let first = opens(&effects).expect("a walk");
    assert!(texts(&effects, 1).is_empty(), "it does not stand yet");
    let effects = played.on(Event::Opened(first, Ok(Described::default())));
    let resume = one(&effects, 1, "welcome")["resume"].as_str().expect("a word").to_owned();
    let second = opens(&played.driver(2)).expect("another");
    assert_ne!(first, second);
    assert_eq!(closed(&played.driver(3), 3), Some(Why::Full));
    // One of them cannot begin: the other knows nothing of it.
    let effects = played.on(Event::Opened(second, Err("no threads".into())));
    assert_eq!((closed(&effects, 2), closed(&effects, 1)), (Some(Why::Over), None));
    assert_eq!(one(&effects, 2, "notice")["text"], "no threads");
    // Whoever comes back finds the walk, until it has ended.
    played.on(Event::Gone(1));
    played.now = 30.0;
    let token = played.token.clone();
    let effects = played.enter(4, &token, Some(&resume));
    assert_eq!((opens(&effects), &one(&effects, 4, "welcome")["role"]), (None, &json!("drives")));
    played.on(Event::Gone(4));
    played.now = 91.0;
    assert!(played.on(Event::Tick).contains(&Effect::End(first)));
}

#[test]
fn a_bounded_viewer_gets_no_more_than_its_rate() {
    let mut played = Played::new(Limits { bytes: Some(4000.0), ..LIMITS });
    played.driver(1);
    let mut bytes = 0;
    for number in 1..=400 {
        played.now += 0.05;
        let effects = played.shows(&shown(number, false));
        for frame in frames(&played.coded(effects), 1) {
            bytes += frame.len();
            played.say(1, json!({"type": "shown", "frame": u32::from(frame[4])}));
        }
        // (Numbers of this test's pictures are a byte.)
        if number >= 250 {
            break;
        }
    }
    let bound = 4000.0 * (played.now + 1.0) + 2000.0;
    assert!(bytes as f64 <= bound && bytes as f64 > 0.4 * bound, "{bytes} of {bound}");
}

/// What a page or somebody else may say.
fn anything() -> impl Strategy<Value = Event> {
    let id = 0..6_u64;
    let words = prop_oneof![
        Just(json!({"type": "do", "name": "take"})),
        Just(json!({"type": "do", "name": "give"})),
        Just(json!({"type": "do", "name": "screenshot"})),
        Just(json!({"type": "do", "name": "bookmark", "number": 255, "set": true})),
        any::<u32>().prop_map(|n| json!({"type": "do", "name": "frame", "number": n})),
        any::<i64>().prop_map(|n| json!({"type": "do", "name": "messages", "count": n})),
        any::<(u32, u32)>().prop_map(|(x, y)| json!({"type": "do", "name": "why", "x": x, "y": y})),
        Just(json!({"type": "do", "name": "branch"})),
        Just(json!({"type": "do", "name": "reload"})),
        any::<(u32, u32)>().prop_map(|(w, h)| json!({"type": "do", "name": "size", "width": w, "height": h})),
        any::<(u16, f32)>().prop_map(|(l, g)| json!({"type": "do", "name": "dim", "lamp": l % 3, "gain": g})),
        any::<u16>().prop_map(|lamp| json!({"type": "do", "name": "bring", "lamp": lamp % 3})),
        Just(json!({"type": "kept"})),
        any::<u32>().prop_map(|frame| json!({"type": "shown", "frame": frame % 12})),
        any::<f64>().prop_map(|value| json!({"type": "set", "key": "fps", "value": value})),
        ".{0,40}".prop_map(|key| json!({"type": "set", "key": key, "value": true})),
        ".{0,60}".prop_map(|text| json!({"type": "hello", "v": 1, "token": text})),
    ];
    prop_oneof![
        4 => (id.clone(), words).prop_map(|(id, text)| Event::Text(id, text.to_string())),
        1 => (id.clone(), ".{0,80}").prop_map(|(id, text)| Event::Text(id, text)),
        2 => (id.clone(), prop::collection::vec(any::<u8>(), 0..120)).prop_map(|(id, b)| Event::Input(id, b)),
        2 => (id.clone(), any::<f64>(), 0..9_u8, any::<f32>(), any::<f32>())
            .prop_map(|(id, t, kind, a, b)| Event::Input(id, input(&[(t, kind, a, b)]))),
        1 => id.clone().prop_map(Event::Gone),
        2 => id.clone().prop_map(|id| Event::Connected(id, IpAddr::from([192, 0, 2, 7]))),
        1 => id.prop_map(|_| Event::Tick),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    /// A hundred thousand messages of whatever kind, among viewers who know the token: nothing panics, nothing grows.
    #[test]
    fn nothing_that_is_said_does_harm(events in prop::collection::vec(anything(), 100)) {
        let mut played = Played::new(LIMITS);
        let mut number = 0;
        for (i, event) in events.into_iter().enumerate() {
            played.now += 0.03;
            if let Event::Connected(id, address) = event {
                let effects = played.on(Event::Connected(id, address));
                played.coded(effects);
                let token = played.token.clone();
                let effects = played.say(id, json!({"type": "hello", "v": VERSION, "token": token}));
                played.coded(effects);
                continue;
            }
            let effects = played.on(event);
            played.coded(effects);
            if i % 5 == 0 {
                number += 1;
                let effects = played.shows(&shown(number, number % 2 == 0));
                played.coded(effects);
            }
            prop_assert!(played.hub.viewers.len() <= 6 && played.hub.rooms.len() == 1);
            prop_assert!(played.hub.viewers.values().all(|viewer| viewer.on_the_way() <= 2));
            for viewer in played.hub.viewers.values() {
                prop_assert!(!viewer.waits);
            }
        }
    }
}

#[test]
fn everybody_hears_of_the_end() {
    let mut played = Played::new(LIMITS);
    played.driver(1);
    played.connect(2);
    let effects = played.hub.shut();
    assert_eq!((closed(&effects, 1), closed(&effects, 2)), (Some(Why::Shutdown), Some(Why::Shutdown)));
    let mut played = Played::new(LIMITS);
    played.driver(1);
    let room = played.room;
    let effects = played.on(Event::Over(room));
    assert_eq!(closed(&effects, 1), Some(Why::Over));
    assert!(effects.contains(&Effect::End(room)));
}
