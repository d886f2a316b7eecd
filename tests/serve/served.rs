//! A server that runs, and what talks to it without a browser.

use std::ffi::OsStr;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

use crate::support::{CHEAP_BAKE, Ended, Foveal, Running, scene};

const PATIENCE: Duration = Duration::from_secs(120);

/// A server.
pub struct Served {
    running: Option<Running>,
    /// Where it listens.
    pub port: u16,
    /// What its address begins with.
    pub base: String,
    /// Of who may drive.
    pub token: String,
    /// Of who may look, where there is such a one.
    pub watch: Option<String>,
}

impl Served {
    /// Serves the box, 96 × 64.
    pub fn start(words: &str) -> Self {
        Self::of(&scene("box"), words)
    }

    /// Serves a scene.
    pub fn of(scene: &Path, words: &str) -> Self {
        Self::with(scene, words, &[])
    }

    /// The same in another environment.
    pub fn with(scene: &Path, words: &str, environment: &[(&str, &OsStr)]) -> Self {
        let said = |option: &str, value: &str| match words.contains(option) {
            true => String::new(),
            false => format!("{option} {value}"),
        };
        let (listen, size) = (said("--listen", "127.0.0.1:0"), said("--size", "96x64"));
        let light = if words.contains("--baked") { "" } else { &format!("--baked {CHEAP_BAKE}") };
        let words = format!("serve {listen} {size} --json {light} {words}");
        let command = environment.iter().fold(Foveal::new(&words), |c, (name, value)| c.env(name, value));
        Self::running(command.arg(scene).start())
    }

    /// Serves a recording.
    pub fn recording(file: &Path) -> Self {
        Self::running(Foveal::new("replay --serve=127.0.0.1:0 --json").arg(file).start())
    }

    /// Once it has said where it listens.
    fn running(mut running: Running) -> Self {
        let until = Instant::now() + PATIENCE;
        let document: Value = loop {
            if let Ok(document) = serde_json::from_str(&running.printed()) {
                break document;
            }
            assert!(running.is_running() && Instant::now() < until, "{}", running.said());
            std::thread::sleep(Duration::from_millis(10));
        };
        assert_eq!(document["schema"], "foveal.serve/1");
        let token = |key: &str| {
            let (_, token) = document[key].as_str()?.split_once("#t=")?;
            Some(token.to_owned())
        };
        let address = document["address"].as_str().expect("an address");
        let port = address.split(['/', ':']).find_map(|part| part.parse().ok()).expect("a port");
        let base = address.split('#').next().unwrap_or_default().to_owned();
        let (drive, watch) = (token("address").expect("a token"), token("watch_address"));
        Self { running: Some(running), port, base, token: drive, watch }
    }

    /// What a user opens.
    pub fn address(&self) -> String {
        format!("http://127.0.0.1:{}/#t={}", self.port, self.token)
    }

    /// What it has said on the standard error.
    pub fn said(&self) -> String {
        self.running.as_ref().expect("it runs").said()
    }

    /// Resident memory, bytes.
    pub fn memory(&self) -> u64 {
        let id = self.running.as_ref().expect("it runs").id();
        let status = std::fs::read_to_string(format!("/proc/{id}/status")).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let kib: Option<u64> = line.and_then(|line| line.trim().split(' ').next()?.parse().ok());
        kib.unwrap_or(0) << 10
    }

    /// Ctrl-C.
    pub fn interrupt(mut self) -> Ended {
        let running = self.running.take().expect("it runs");
        let status = Command::new("kill").args(["-INT", &running.id().to_string()]).status();
        assert!(status.expect("kill").success());
        running.wait()
    }

    /// The answer to a request, as it came.
    pub fn get(&self, path: &str, headers: &str) -> String {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        // Who is turned away may hear of it before they have asked.
        let _ = write!(stream, "GET {path} HTTP/1.1\r\nConnection: close\r\n{headers}\r\n\r\n");
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    /// The answer to a form that somebody sends without a script: its head, and what it holds.
    pub fn post(&self, path: &str, headers: &str, form: &str) -> (String, Vec<u8>) {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        let length = form.len();
        let _ = write!(
            stream,
            "POST {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}\r\n\r\n{form}"
        );
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let head = answer.windows(4).position(|four| four == b"\r\n\r\n").expect("a head") + 4;
        (String::from_utf8_lossy(&answer[..head]).into_owned(), answer[head..].to_vec())
    }

    /// The WebSocket, as a page of this origin would open it at this host.
    pub fn socket(&self, host: &str, origin: Option<&str>) -> Result<Viewer, Box<tungstenite::Error>> {
        let mut request =
            format!("ws://127.0.0.1:{}/walk", self.port).into_client_request().expect("a request");
        let value = |text: &str| HeaderValue::from_str(text).expect("a header");
        request.headers_mut().insert("Host", value(host));
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", value(origin));
        }
        let stream = TcpStream::connect(("127.0.0.1", self.port)).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Viewer { socket, number: 0, last: Vec::new() }),
            Err(tungstenite::HandshakeError::Failure(e)) => Err(Box::new(e)),
            Err(e) => panic!("{e}"),
        }
    }

    /// The same from the server's own page.
    pub fn viewer(&self) -> Viewer {
        let host = format!("127.0.0.1:{}", self.port);
        self.socket(&host, Some(&format!("http://{host}"))).expect("a page of its own is let in")
    }

    /// Somebody who has said hello with this token.
    pub fn hello(&self, token: &str) -> Viewer {
        let mut viewer = self.viewer();
        viewer.say(&json!({"type": "hello", "v": 1, "token": token}));
        viewer
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        if let Some(running) = self.running.take() {
            running.kill();
        }
    }
}

/// Somebody who looks, without a browser.
pub struct Viewer {
    pub socket: WebSocket<TcpStream>,
    /// Number of the last frame.
    pub number: u32,
    /// The last frame.
    pub last: Vec<u8>,
}

impl Viewer {
    /// Says something.
    pub fn say(&mut self, message: &Value) {
        let _ = self.socket.send(Message::text(message.to_string()));
    }

    /// The next thing that is said of this type; frames that come before are drawn.
    pub fn hears(&mut self, kind: &str) -> Value {
        loop {
            match self.socket.read().unwrap_or_else(|e| panic!("no {kind}: {e}")) {
                Message::Text(text) => {
                    let message: Value = serde_json::from_str(&text).expect("JSON");
                    if message["type"] == kind {
                        return message;
                    }
                }
                Message::Binary(frame) => self.draws(&frame),
                _ => {}
            }
        }
    }

    /// The next frame that is as wanted: its head's flags, and the whole.
    pub fn sees(&mut self, wanted: impl Fn(u8) -> bool) -> Vec<u8> {
        loop {
            if let Message::Binary(frame) = self.socket.read().expect("a frame") {
                self.draws(&frame);
                if wanted(frame[1]) {
                    return frame.to_vec();
                }
            }
        }
    }

    /// The picture that the walk gives to keep, a file.
    pub fn keeps(&mut self) -> Vec<u8> {
        self.say(&json!({"type": "do", "name": "screenshot"}));
        loop {
            match self.socket.read().expect("a file") {
                Message::Binary(file) if file[0] == 2 => {
                    self.say(&json!({"type": "kept"}));
                    return file[1..].to_vec();
                }
                Message::Binary(frame) => self.draws(&frame),
                _ => {}
            }
        }
    }

    fn draws(&mut self, frame: &[u8]) {
        self.number = u32::from_le_bytes(frame[4..8].try_into().expect("four bytes"));
        self.last = frame.to_vec();
        self.say(&json!({"type": "shown", "frame": self.number}));
    }

    /// The code that it is closed with.
    pub fn closed(&mut self) -> Option<u16> {
        loop {
            match self.socket.read() {
                Ok(Message::Close(frame)) => return frame.map(|frame| frame.code.into()),
                Ok(_) => {}
                Err(_) => return None,
            }
        }
    }
}
