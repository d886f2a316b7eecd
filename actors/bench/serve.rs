//! `foveal bench serve`: what the browser's door adds to a walk: time from input to picture, bytes, coding, and whether
//! the walk notices its viewers.

use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use clap::Args;
use foveal_engine::failure::Failure;
use foveal_engine::light::Light;
use foveal_engine::navigation::Motion;
use foveal_engine::recipe::Recipe;
use foveal_engine::source::FrameSource;
use foveal_engine::thread::{Command, EngineThread, Shown};
use foveal_engine::walk::Act;
use foveal_engine::{Engine, Options, Settings};
use foveal_serve::coding::{Coding, encode};
use foveal_serve::gate::Token;
use foveal_serve::hub::Limits;
use foveal_serve::server::{self, Make, Server};
use foveal_terminal::arguments::{Size, duration};
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish};
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

use super::made::Subject;
use super::timed;

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long a still view is left alone before the next turn of the head, so that no frame is under way.
const REST: Duration = Duration::from_millis(400);
/// Viewers of the walk that is to notice nothing.
const VIEWERS: usize = 8;

/// Arguments of `foveal bench serve`.
#[derive(Args, Debug)]
pub struct ServeArguments {
    /// A scene file, or one of ours by name
    #[arg(long, value_name = "SCENE", default_value = "box")]
    scene: String,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: Size,
    /// How long one walks to see how evenly frames come
    #[arg(long, value_name = "TIME", value_parser = duration, default_value = "12s")]
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
        ..Recipe::new(subject.path(), Settings::new(a.size.width, a.size.height, cores))
    };
    let loaded = recipe.load(&recipe.scene, &())?;
    let settings = recipe.settings;
    let make: Make = Arc::new(move |_| {
        let probes = Some(Arc::clone(&loaded.probes));
        let options = Options { probes, ..Options::interactive(settings) };
        let engine = Engine::start(loaded.opened.clone(), options)?;
        Ok((Box::new(engine) as Box<dyn FrameSource>).into())
    });
    let bar = progress.bar(4, "serve");
    let inputs = 4 * a.common.runs.max(1);
    let name = format!("{}, {}×{}", Subject::name(&a.scene), a.size.width, a.size.height);

    let (alone, alone_p99, picture) = {
        let make = Arc::clone(&make);
        let engine = EngineThread::spawn(move || make(1), || {})?;
        let waits = (0..inputs).map(|i| look_at(&engine, i)).collect::<Result<Vec<f64>, Failure>>()?;
        let p99 = walk_alone(&engine, a.walk)?;
        let shown = wait(&engine, |shown| shown.exact)?;
        (waits, p99, shown.picture)
    };
    bar.inc(1);
    let served = Served::start(&make)?;
    let mut driver = served.viewer()?;
    let first = driver.began.elapsed().as_secs_f64() * 1e3;
    let waits = (0..inputs).map(|i| driver.look(i)).collect::<Result<Vec<f64>, Failure>>()?;
    bar.inc(1);
    let walked = driver.walk(a.walk)?;
    bar.inc(1);
    let stalled = served.viewer()?;
    let stops = Arc::new(AtomicBool::new(false));
    let others =
        (2..VIEWERS).map(|_| Ok(served.viewer()?.looks_on(&stops))).collect::<Result<Vec<_>, Failure>>()?;
    let crowded = driver.walk(a.walk)?;
    stops.store(true, Ordering::Relaxed);
    for other in others {
        let _ = other.join();
    }
    drop((stalled, driver));
    served.end()?;
    bar.finish_and_clear();

    let coded = |coding| -> Vec<f64> {
        (0..a.common.runs.max(1)).map(|_| timed(|| encode(&picture, None, coding)).0).collect()
    };
    let middle = |values: &[f64]| foveal_terminal::table::median(values);
    let own: Vec<f64> = waits.iter().map(|wait| wait - middle(&alone).unwrap_or(0.0)).collect();
    let kib = |bytes: &[f64]| bytes.iter().map(|b| b / 1024.0).collect::<Vec<f64>>();
    let jpeg = Coding::Jpeg { quality: 80, half: false };
    let rows = [
        Row::new(format!("connect → first frame, {name}"), "ms", &[first]).aim(Aim::AtMost(600.0)),
        Row::new("input → frame", "ms", &waits).against("without the door", middle(&alone)),
        Row::new("  the door's own part of it", "ms", &own).aim(Aim::AtMost(6.0)),
        Row::new("  bytes of a frame while walking", "KiB", &kib(&walked.bytes)).aim(Aim::AtMost(40.0)),
        Row::new("coding a frame, JPEG", "ms", &coded(jpeg)),
        Row::new("coding a still picture, WebP without loss", "ms", &coded(Coding::Lossless)),
        Row::new("frame while walking, p99, one viewer", "ms", &[walked.p99])
            .against("none", Some(alone_p99)),
        Row::new(format!("  {VIEWERS} viewers, one of whom reads nothing"), "ms", &[crowded.p99])
            .against("none", Some(alone_p99)),
    ];
    let notes = ["viewers are threads of this process and take their part of its cores".to_owned()];
    finish("serve", &rows, &notes, &a.common)
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

/// From a still view a turn of the head: milliseconds until a picture knows of it.
fn look_at(engine: &EngineThread, number: u32) -> Result<f64, Failure> {
    let handle = engine.handle();
    let act = Act::Look(1.0 + (number % 3) as f32, 0.0);
    if number == 0 {
        wait(engine, |shown| shown.exact)?;
    }
    std::thread::sleep(REST);
    let (begin, mark) = (Instant::now(), f64::from(number) + 1.0);
    let _ = handle.send(Command::Act { act, at: handle.now(), mark });
    let shown = wait(engine, |shown| shown.mark == Some(mark))?;
    let took = begin.elapsed().as_secs_f64() * 1e3;
    if !shown.exact {
        wait(engine, |shown| shown.exact)?;
    }
    Ok(took)
}

/// Walks to and fro; the 99th percentile of frame times, milliseconds.
fn walk_alone(engine: &EngineThread, time: Duration) -> Result<f64, Failure> {
    let handle = engine.handle();
    let begin = Instant::now();
    let mut p99 = 0.0;
    let mut way = 0;
    while begin.elapsed() < time {
        for act in to_and_fro(begin, &mut way) {
            let _ = handle.send(Command::Act { act, at: handle.now(), mark: 0.0 });
        }
        if let Some((_, slowest)) = handle.shown().and_then(|shown| shown.report.times) {
            p99 = f64::from(slowest) * 1e3;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let _ = handle.send(Command::Act { act: Act::ReleaseAll, at: handle.now(), mark: 0.0 });
    Ok(p99)
}

/// What hands do now, who turn round twice a second.
fn to_and_fro(begin: Instant, way: &mut u32) -> Vec<Act> {
    let now = (begin.elapsed().as_secs_f64() * 2.0) as u32 + 1;
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
        let thread = std::thread::spawn(move || server.run(make, || asked.load(Ordering::Relaxed), || {}));
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
        stream.set_read_timeout(Some(PATIENCE)).map_err(|e| failed(&e))?;
        let (socket, _) = tungstenite::client(request, stream).map_err(|e| failed(&e))?;
        let mut viewer = Viewer { socket, began, still: false, mark: 0.0, bytes: Vec::new(), p99: 0.0 };
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
    bytes: Vec<f64>,
    p99: f64,
}

/// What a walk was like to a viewer.
struct Walked {
    bytes: Vec<f64>,
    p99: f64,
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
                self.still = frame[1] == 3;
                self.bytes.push(frame.len() as f64);
                let number = u64::from_le_bytes(bytes(4)) as u32;
                self.say(&json!({"type": "shown", "frame": number}))
            }
            Ok(Message::Text(text)) => {
                let message: Value = serde_json::from_str(&text).unwrap_or_default();
                if let Some(p99) = message["times"][1].as_f64() {
                    self.p99 = p99;
                }
                Ok(())
            }
            Ok(_) => Ok(()),
            Err(e) => Err(Failure::Check(format!("the server says no more: {e}"))),
        }
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

    fn look(&mut self, number: u32) -> Result<f64, Failure> {
        self.until(|viewer| viewer.still)?;
        std::thread::sleep(REST);
        let (begin, mark) = (Instant::now(), self.began.elapsed().as_secs_f64() * 1e3);
        self.act(3, 1.0 + (number % 3) as f32, mark)?;
        self.until(|viewer| viewer.mark == mark)?;
        let took = begin.elapsed().as_secs_f64() * 1e3;
        self.still = false;
        Ok(took)
    }

    fn walk(&mut self, time: Duration) -> Result<Walked, Failure> {
        let begin = Instant::now();
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
        Ok(Walked { bytes: std::mem::take(&mut self.bytes), p99: self.p99 })
    }

    /// Draws what comes until it `stops`.
    fn looks_on(mut self, stops: &Arc<AtomicBool>) -> JoinHandle<()> {
        let stops = Arc::clone(stops);
        std::thread::spawn(move || while !stops.load(Ordering::Relaxed) && self.hear().is_ok() {})
    }
}
