//! `foveal bench serve`: what the browser's door adds to a walk: time from input to picture, bytes, coding, and whether
//! the walk notices its viewers.

use std::fs;
use std::io::ErrorKind;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use clap::Args;
use foveal::image::Map2d;
use foveal::metrics::quantile;
use foveal_engine::Settings;
use foveal_engine::failure::Failure;
use foveal_engine::light::Light;
use foveal_engine::navigation::Motion;
use foveal_engine::process::memory_bytes;
use foveal_engine::recipe::{Loaded, Recipe};
use foveal_engine::source::FrameSource;
use foveal_engine::thread::{Command, EngineThread, Shown};
use foveal_engine::walk::Act;
use foveal_serve::coding::{Coding, encode};
use foveal_serve::gate::Token;
use foveal_serve::hub::Limits;
use foveal_serve::server::{self, Make, Server};
use foveal_terminal::arguments::{Size, duration, positive};
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish};
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Error, Message, WebSocket};

use super::made::Subject;
use super::timed;

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long a still view is left alone before the next turn of the head, so that no frame is under way.
const REST: Duration = Duration::from_millis(400);
/// How long a walk is left to converge before another one begins.
const SETTLING: Duration = Duration::from_secs(2);
/// How long one walks in a direction.
const TURNS: Duration = Duration::from_millis(500);
/// Walks of each kind in a run: late frames are rare, and come in heaps.
const ROUNDS: u32 = 3;
/// Viewers of the walk that is to notice nothing.
const VIEWERS: usize = 8;

type Picture = Arc<Map2d<[u8; 3]>>;

/// How long a viewer waits for a message before it looks whether its hands have something to do.
const HANDS: Duration = Duration::from_millis(5);
/// Connects of which some are made before memory is looked at.
const CONNECTS: [usize; 2] = [100, 1000];
/// Frames a second at which the door's time is told.
const FPS: f64 = 30.0;

/// Arguments of `foveal bench serve`.
#[derive(Args, Debug)]
pub struct ServeArguments {
    /// Scene file, or the name of a bundled scene
    #[arg(long, value_name = "SCENE", default_value = "box")]
    scene: String,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: Size,
    /// Target frame rate
    #[arg(long, value_parser = positive, default_value_t = FPS as f32)]
    fps: f32,
    /// Length of each walk that measures the regularity of frames, at least 120 frames; there are three per run, with
    /// no, one and eight viewers
    #[arg(long, value_name = "TIME", value_parser = duration, default_value = "5s")]
    walk: Duration,
    #[command(flatten)]
    common: CommonArguments,
}

/// Runs the benchmark.
pub fn run(a: &ServeArguments, progress: Progress) -> Result<(), Failure> {
    let subject = Subject::of(&a.scene)?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
    let recipe = Recipe {
        light: Light { quick: true, ..Light::default() },
        fps: Some(a.fps),
        ..Recipe::new(subject.path(), Settings::new(a.size.width, a.size.height, cores))
    };
    let loaded = recipe.load(&recipe.scene, &())?;
    let shown_in_window = recipe.clone();
    let make: Make = Arc::new(move |number| {
        let loaded = Loaded { opened: loaded.opened.clone(), probes: Arc::clone(&loaded.probes) };
        Ok((Box::new(recipe.start(loaded, number)?) as Box<dyn FrameSource>).into())
    });
    let bar = progress.bar(u64::from(a.common.runs) + 1, "serve");
    let inputs = 8 * a.common.runs;
    let name = format!("{}, {}×{}", Subject::name(&a.scene), a.size.width, a.size.height);

    let first_of_all = Arc::clone(&make);
    let engine = EngineThread::spawn(move || first_of_all(1), || {})?;
    let mut picture = wait(&engine, |shown| shown.exact)?.picture;
    let served = Served::start(&make)?;
    let mut driver = served.viewer()?;
    let first = driver.began.elapsed().as_secs_f64() * 1e3;
    // In turn, so that whatever else the machine does meets both.
    let (mut alone, mut waits, mut own) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..inputs {
        alone.push(look_at(&engine, i, &mut picture)?);
        let [wait, door] = driver.look(i)?;
        waits.push(wait);
        own.push(door);
    }
    bar.inc(1);
    let (mut none, mut one, mut crowd) = (Vec::new(), Vec::new(), Vec::new());
    engine.end().map_err(|e| Failure::ended(&e))?;
    for _ in 0..a.common.runs {
        for i in 0..3 * ROUNDS {
            match i % 3 {
                0 => none.push(driver.walk(a.walk, false)?),
                1 => one.push(driver.walk(a.walk, true)?),
                _ => crowd.push(walk_in_a_crowd(&served, &mut driver, a.walk)?),
            }
            // What is still to be traced is not to be in the next walk's way.
            std::thread::sleep(SETTLING);
        }
        bar.inc(1);
    }
    let memory = connects(&served, a.common.runs)?;
    drop(driver);
    served.end()?;
    let window = in_window(shown_in_window, a.walk)?;
    bar.finish_and_clear();

    let coded = |coding| -> Vec<f64> {
        (0..a.common.runs).map(|_| timed(|| encode(&picture, None, coding)).0).collect()
    };
    let middle = |values: &[f64]| foveal_terminal::table::median(values);
    let jpeg = Coding::Jpeg { quality: 80, half: false };
    let bytes: Vec<f64> = one.iter().flat_map(|walked| &walked.bytes).map(|b| b / 1024.0).collect();
    // At so many frames a second, whatever this machine makes of them.
    let cpu = |walks: &[ViewerResults]| -> Vec<f64> {
        walks.iter().filter_map(|w| Some(w.cpu? * FPS * 100.0)).collect()
    };
    let (by_one, by_all) = (cpu(&one), cpu(&crowd));
    // One of them reads nothing.
    let further: Vec<f64> =
        by_one.iter().zip(&by_all).map(|(one, all)| (all - one) / (VIEWERS - 2) as f64).collect();
    let p99s = |walks: &[ViewerResults]| walks.iter().map(|walked| walked.p99).collect::<Vec<f64>>();
    let high = |values: &[f64]| vec![quantile(values.iter().copied(), 0.95)];
    let mut notes = vec!["viewers are threads of this process and take their part of its cores".to_owned()];
    let window = window.map_err(|e| notes.push(format!("no window to hold it against: {e}"))).ok();
    let beside_window = window.map(|p99| {
        Row::new("  beside the window, which serves nobody", "ms", &p99s(&one)).against("window", Some(p99))
    });
    let rows: Vec<Row> = [
        Row::new(format!("connect → first frame, {name}"), "ms", &[first]).aim(Aim::AtMost(600.0)),
        Row::new("input → frame", "ms", &waits).against("without the door", middle(&alone)),
        Row::new("  the door's own part of it", "ms", &own).aim(Aim::AtMost(6.0)),
        Row::new("  p95 of that", "ms", &high(&own)).aim(Aim::AtMost(12.0)),
        Row::new("  bytes of a frame while walking", "KiB", &bytes).aim(Aim::AtMost(40.0)),
        Row::new("coding a frame, JPEG", "ms", &coded(jpeg)),
        Row::new("coding a still picture, WebP without loss", "ms", &coded(Coding::Lossless)),
        Row::new("processor for one viewer at 30 frames a second", "% of a core", &by_one)
            .aim(Aim::AtMost(8.0)),
        Row::new("  for each further one", "% of a core", &further).aim(Aim::AtMost(1.0)),
        Row::new("frame while walking, p99, one viewer", "ms", &p99s(&one))
            .against("none", middle(&p99s(&none))),
        Row::new(format!("  {VIEWERS} viewers, one of whom reads nothing"), "ms", &p99s(&crowd))
            .against("none", middle(&p99s(&none)))
            .aim(Aim::RatioAtMost(1.05)),
        Row::new(format!("memory after {} more connects", CONNECTS[1]), "MiB", &memory).aim(Aim::AtMost(5.0)),
    ]
    .into_iter()
    .chain(beside_window)
    .collect();
    finish("serve", &rows, &notes, &a.common)
}

/// The 99th percentile of frame times in the window while one walks there, milliseconds; why there is none, where that is so.
#[cfg(feature = "window")]
fn in_window(recipe: Recipe, time: Duration) -> Result<Result<f64, String>, Failure> {
    use foveal_window::{Options, WindowError, probe::Probe};
    let options =
        Options { probe: Some(Probe::new(time, Duration::ZERO).turning(TURNS)), ..Options::new(recipe) };
    match foveal_window::run(options) {
        Ok(measured) => {
            Ok(measured.frames.map(|(_, p99)| f64::from(p99) * 1e3).ok_or("it showed nothing".into()))
        }
        Err(WindowError::Environment(e)) => Ok(Err(e)),
        Err(WindowError::Scene(e)) => Err(Failure::Input(e)),
        Err(WindowError::Ended(e)) => Err(Failure::ended(&e)),
    }
}

/// There is none in this build.
#[cfg(not(feature = "window"))]
fn in_window(_: Recipe, _: Duration) -> Result<Result<f64, String>, Failure> {
    Ok(Err("it is not built in".into()))
}

/// MiB that a thousand who come, look and go leave behind; fewer where there is one run, to see that it works.
fn connects(served: &Served, runs: u32) -> Result<Vec<f64>, Failure> {
    let [before, more] = CONNECTS.map(|count| if runs > 1 { count } else { count / 10 });
    let visit = |count| (0..count).try_for_each(|_| served.viewer().map(drop));
    visit(before)?;
    let Some(had) = memory_bytes() else { return Ok(Vec::new()) };
    visit(more)?;
    Ok(memory_bytes().map(|has| (has as f64 - had as f64) / f64::from(1 << 20)).into_iter().collect())
}

/// Seconds of processor time that the server's threads have taken; `None` where the system does not tell.
fn door_cpu() -> Option<f64> {
    let mut sum = 0.0;
    for task in fs::read_dir("/proc/self/task").ok()?.flatten() {
        // A thread may have ended meanwhile.
        let read = |name| fs::read_to_string(task.path().join(name)).unwrap_or_default();
        if read("comm").starts_with(server::THREADS) {
            let taken: Option<f64> = read("schedstat").split(' ').next().and_then(|ns| ns.parse().ok());
            sum += taken.unwrap_or(0.0) * 1e-9;
        }
    }
    Some(sum)
}

fn never(what: &str) -> Failure {
    Failure::Check(format!("{what} within {} s", PATIENCE.as_secs()))
}

/// The next thing that a walk shows which is as wanted.
fn wait(engine: &EngineThread, wanted: impl Fn(&Shown) -> bool) -> Result<Shown, Failure> {
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        match engine.handle().shown() {
            Some(shown) if wanted(&shown) => return Ok((*shown).clone()),
            _ => std::thread::sleep(Duration::from_micros(200)),
        }
    }
    Err(never("it was not shown"))
}

/// From a still view a turn of the head: milliseconds until a picture knows of it, and the still one that it leads to.
fn look_at(engine: &EngineThread, number: u32, picture: &mut Picture) -> Result<f64, Failure> {
    let handle = engine.handle();
    let act = Act::Look(1.0 + (number % 3) as f32, 0.0);
    std::thread::sleep(REST);
    let (begin, mark) = (Instant::now(), f64::from(number) + 1.0);
    let _ = handle.send(Command::Act { act, at: handle.now(), mark });
    let mut shown = wait(engine, |shown| shown.mark == Some(mark))?;
    let took = begin.elapsed().as_secs_f64() * 1e3;
    if !shown.exact {
        shown = wait(engine, |shown| shown.exact)?;
    }
    *picture = shown.picture;
    Ok(took)
}

/// Walks while seven more look on, of whom one reads nothing.
fn walk_in_a_crowd(served: &Served, driver: &mut Viewer, time: Duration) -> Result<ViewerResults, Failure> {
    let _stalled = served.viewer()?;
    let stops = Arc::new(AtomicBool::new(false));
    let others = (2..VIEWERS).map(|_| Ok(served.viewer()?.looks_on(&stops)));
    let others = others.collect::<Result<Vec<_>, Failure>>()?;
    let walked = driver.walk(time, true);
    stops.store(true, Ordering::Relaxed);
    for other in others {
        let _ = other.join();
    }
    walked
}

/// What hands do now, who turn round twice a second.
fn to_and_fro(begin: Instant, way: &mut u32) -> Vec<Act> {
    let now = (begin.elapsed().as_secs_f64() / TURNS.as_secs_f64()) as u32 + 1;
    if now == *way {
        return Vec::new();
    }
    *way = now;
    let motions = [Motion::Left, Motion::Right];
    vec![Act::ReleaseAll, Act::Press(motions[now as usize % 2])]
}

/// A server on a thread of its own.
struct Served {
    port: u16,
    token: Token,
    stops: Arc<AtomicBool>,
    thread: JoinHandle<Result<(), Failure>>,
}

impl Served {
    fn start(make: &Make) -> Result<Self, Failure> {
        let token = Token::random().map_err(Failure::Environment)?;
        let server = Server::bind(server::Options {
            listen: ([127, 0, 0, 1], 0).into(),
            hosts: Vec::new(),
            // All viewers come from one address.
            behind_proxy: true,
            token: token.clone(),
            watch_token: None,
            limits: Limits { walks: None, viewers: 16, bytes: None, idle: 600.0 },
            recorded: false,
            tls: None,
        })?;
        let port = server.address().port();
        let stops = Arc::new(AtomicBool::new(false));
        let (make, asked) = (Arc::clone(make), Arc::clone(&stops));
        let run = move || server.run(make, || asked.load(Ordering::Relaxed), || {});
        let thread = std::thread::Builder::new().name(server::THREADS.into()).spawn(run);
        let thread = thread.map_err(|e| Failure::Environment(format!("no thread to serve on: {e}")))?;
        Ok(Self { port, token, stops, thread })
    }

    fn viewer(&self) -> Result<Viewer, Failure> {
        let failed = |e: &dyn std::fmt::Display| Failure::Environment(format!("no viewer: {e}"));
        let began = Instant::now();
        let host = format!("127.0.0.1:{}", self.port);
        let mut request = format!("ws://{host}/walk").into_client_request().map_err(|e| failed(&e))?;
        let origin = HeaderValue::from_str(&format!("http://{host}")).map_err(|e| failed(&e))?;
        request.headers_mut().insert("Origin", origin);
        let stream = TcpStream::connect(&host).map_err(|e| failed(&e))?;
        let (socket, _) = tungstenite::client(request, stream).map_err(|e| failed(&e))?;
        socket.get_ref().set_read_timeout(Some(HANDS)).map_err(|e| failed(&e))?;
        let mut viewer = Viewer {
            socket,
            began,
            still: false,
            mark: 0.0,
            took: 0.0,
            bytes: Vec::new(),
            p99: 0.0,
            looks: true,
            unseen: Vec::new(),
        };
        viewer.say(&json!({"type": "hello", "v": 1, "token": self.token.as_str()}))?;
        viewer.until(|viewer| !viewer.bytes.is_empty())?;
        Ok(viewer)
    }

    fn end(self) -> Result<(), Failure> {
        self.stops.store(true, Ordering::Relaxed);
        self.thread.join().map_err(|_| Failure::Check("the server panicked".into()))?
    }
}

/// Somebody who looks.
struct Viewer {
    socket: WebSocket<TcpStream>,
    began: Instant,
    /// The last frame was exact.
    still: bool,
    mark: f64,
    /// What of the time since that the walk took, milliseconds.
    took: f64,
    bytes: Vec<f64>,
    p99: f64,
    /// Says that frames were drawn; to whom does not, none are sent after the second.
    looks: bool,
    /// Frames of which it has not said so.
    unseen: Vec<u32>,
}

/// What a walk was like to a viewer.
struct ViewerResults {
    bytes: Vec<f64>,
    p99: f64,
    /// Seconds of the server's processor time for each frame.
    cpu: Option<f64>,
}

impl Viewer {
    fn say(&mut self, message: &Value) -> Result<(), Failure> {
        let sent = self.socket.send(Message::text(message.to_string()));
        sent.map_err(|e| Failure::Check(format!("the server listens no more: {e}")))
    }

    fn act(&mut self, kind: u8, a: f32, mark: f64) -> Result<(), Failure> {
        let bytes = [&mark.to_le_bytes()[..], &[kind], &a.to_le_bytes(), &0.0_f32.to_le_bytes()].concat();
        let sent = self.socket.send(Message::binary(bytes));
        sent.map_err(|e| Failure::Check(format!("the server listens no more: {e}")))
    }

    /// Takes the next message.
    fn hear(&mut self) -> Result<(), Failure> {
        match self.socket.read() {
            Ok(Message::Binary(frame)) if frame.len() > 32 => {
                let bytes = |at: usize| frame[at..at + 8].try_into().unwrap_or_default();
                self.mark = f64::from_le_bytes(bytes(24));
                self.took = f64::from(u16::from_le_bytes([frame[18], frame[19]])) / 10.0;
                self.still = frame[1] == 3;
                self.bytes.push(frame.len() as f64);
                self.unseen.push(u64::from_le_bytes(bytes(4)) as u32);
                if self.looks { self.see() } else { Ok(()) }
            }
            Ok(Message::Text(text)) => {
                let message: Value = serde_json::from_str(&text).unwrap_or_default();
                if let Some(p99) = message["times"][1].as_f64() {
                    self.p99 = p99;
                }
                Ok(())
            }
            Ok(_) => Ok(()),
            Err(Error::Io(e)) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(()),
            Err(e) => Err(Failure::Check(format!("the server says no more: {e}"))),
        }
    }

    /// Says that all frames were drawn.
    fn see(&mut self) -> Result<(), Failure> {
        let unseen = std::mem::take(&mut self.unseen);
        unseen.into_iter().try_for_each(|frame| self.say(&json!({"type": "shown", "frame": frame})))
    }

    fn until(&mut self, holds: impl Fn(&Self) -> bool) -> Result<(), Failure> {
        let until = Instant::now() + PATIENCE;
        while !holds(self) {
            self.hear()?;
            if Instant::now() > until {
                return Err(never("nothing of the kind was sent"));
            }
        }
        Ok(())
    }

    /// From a still view a turn of the head: milliseconds until a frame knows of it, and those that the walk did not take.
    fn look(&mut self, number: u32) -> Result<[f64; 2], Failure> {
        self.until(|viewer| viewer.still)?;
        std::thread::sleep(REST);
        let (begin, mark) = (Instant::now(), self.began.elapsed().as_secs_f64() * 1e3);
        self.act(3, 1.0 + (number % 3) as f32, mark)?;
        self.until(|viewer| viewer.mark == mark)?;
        let took = begin.elapsed().as_secs_f64() * 1e3;
        self.still = false;
        Ok([took, took - self.took])
    }

    /// Walks to and fro from one place, since that would else lead out of the room in the end, where nothing is to be
    /// seen; with eyes shut where it does not `look`.
    fn walk(&mut self, time: Duration, look: bool) -> Result<ViewerResults, Failure> {
        self.looks = look;
        if look {
            self.see()?;
        }
        self.say(&json!({"type": "do", "name": "bookmark", "number": 0, "set": false}))?;
        let (begin, taken) = (Instant::now(), door_cpu());
        let mut way = 0;
        self.bytes.clear();
        while begin.elapsed() < time {
            for act in to_and_fro(begin, &mut way) {
                let mark = self.began.elapsed().as_secs_f64() * 1e3;
                match act {
                    Act::Press(Motion::Left) => self.act(1, 2.0, mark)?,
                    Act::Press(_) => self.act(1, 3.0, mark)?,
                    _ => self.act(6, 0.0, mark)?,
                }
            }
            self.hear()?;
        }
        self.act(6, 0.0, self.began.elapsed().as_secs_f64() * 1e3)?;
        self.looks = true;
        self.see()?;
        let (bytes, p99) = (std::mem::take(&mut self.bytes), self.p99);
        let cpu = door_cpu().zip(taken).map(|(now, then)| (now - then) / bytes.len().max(1) as f64);
        Ok(ViewerResults { bytes, p99, cpu })
    }

    /// Draws what comes until it `stops`.
    fn looks_on(mut self, stops: &Arc<AtomicBool>) -> JoinHandle<()> {
        let stops = Arc::clone(stops);
        std::thread::spawn(move || while !stops.load(Ordering::Relaxed) && self.hear().is_ok() {})
    }
}
