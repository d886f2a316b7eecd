//! A browser without a screen, driven over its DevTools: Chromium, where there is one.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

use super::folder;

/// Longest that anything may take, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(90);

/// A browser; it ends with this.
pub struct Browser {
    child: Child,
    port: u16,
}

/// A tab of it.
pub struct Page {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    last: u64,
    /// What went wrong in it, and what it asked for.
    pub errors: Vec<String>,
    /// Addresses that it asked for.
    pub requests: Vec<String>,
}

impl Browser {
    /// Starts one. `None`, and a word on the standard error, where there is none.
    pub fn open() -> Option<Self> {
        let names = ["chromium", "chromium-browser", "google-chrome"];
        let profile = folder("browser");
        let started = names.iter().find_map(|name| {
            Command::new(name)
                .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"])
                .args(["--no-first-run", "--disable-background-networking", "--hide-scrollbars"])
                .arg(format!("--user-data-dir={}", profile.display()))
                .arg("about:blank")
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .ok()
        });
        let Some(child) = started else {
            eprintln!("skipped: there is no Chromium ({})", names.join(", "));
            return None;
        };
        let mut browser = Self { child, port: 0 };
        let file = profile.join("DevToolsActivePort");
        let until = Instant::now() + PATIENCE;
        while Instant::now() < until {
            let text = fs::read_to_string(&file).unwrap_or_default();
            if let Some(port) = text.lines().next().and_then(|line| line.parse().ok()) {
                browser.port = port;
                return Some(browser);
            }
            if let Ok(Some(status)) = browser.child.try_wait() {
                eprintln!("skipped: Chromium does not start here ({status})");
                return None;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("Chromium opens no port");
    }

    /// A new tab.
    pub fn page(&self) -> Page {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("the browser listens");
        let request = format!(
            "PUT /json/new?about:blank HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nConnection: close\r\n\r\n",
            self.port
        );
        stream.write_all(request.as_bytes()).expect("a request");
        let mut answer = Vec::new();
        // The browser may leave the connection open; the answer is whole before.
        stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a timeout");
        let target: Value = loop {
            let mut part = [0; 4096];
            let count = stream.read(&mut part).expect("an answer");
            answer.extend(&part[..count]);
            let text = String::from_utf8_lossy(&answer);
            let body = text.split_once("\r\n\r\n").map(|(_, body)| body).unwrap_or_default();
            if let Ok(target) = serde_json::from_str(body) {
                break target;
            }
            assert!(count > 0, "{text}");
        };
        let address = target["webSocketDebuggerUrl"].as_str().expect("an address");
        let (socket, _) = tungstenite::connect(address).expect("DevTools");
        if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
            stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        }
        let mut page = Page { socket, last: 0, errors: Vec::new(), requests: Vec::new() };
        for domain in ["Page", "Runtime", "Log", "Network"] {
            page.call(&format!("{domain}.enable"), json!({}));
        }
        page
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Page {
    /// Calls a method of DevTools.
    pub fn call(&mut self, method: &str, params: Value) -> Value {
        self.ask(method, params).unwrap_or_else(|e| panic!("{method}: {e}"))
    }

    /// The same, which may be answered with an error.
    fn ask(&mut self, method: &str, params: Value) -> Result<Value, Value> {
        self.last += 1;
        let id = self.last;
        let text = json!({"id": id, "method": method, "params": params}).to_string();
        self.socket.send(Message::text(text)).expect("the browser listens");
        loop {
            let message = self.socket.read().unwrap_or_else(|e| panic!("{method}: {e}"));
            let Message::Text(text) = message else { continue };
            let mut message: Value = serde_json::from_str(&text).expect("JSON");
            if message["id"] == id {
                let error = message["error"].take();
                return if error.is_null() { Ok(message["result"].take()) } else { Err(error) };
            }
            self.hear(&message);
        }
    }

    fn hear(&mut self, message: &Value) {
        let params = &message["params"];
        match message["method"].as_str() {
            Some("Runtime.exceptionThrown") => self.errors.push(params["exceptionDetails"].to_string()),
            Some("Log.entryAdded") if params["entry"]["level"] == "error" => {
                self.errors.push(params["entry"].to_string());
            }
            Some("Runtime.consoleAPICalled") if params["type"] == "error" => {
                self.errors.push(params["args"].to_string());
            }
            Some("Network.requestWillBeSent") => {
                self.requests.extend(params["request"]["url"].as_str().map(str::to_owned));
            }
            Some("Network.webSocketCreated") => {
                self.requests.extend(params["url"].as_str().map(str::to_owned));
            }
            _ => {}
        }
    }

    /// Goes to an address.
    pub fn go(&mut self, address: &str) {
        self.call("Page.navigate", json!({"url": address}));
    }

    /// The value of an expression, which may be a promise.
    pub fn eval(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let mut answer = self.call("Runtime.evaluate", params);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].take()
    }

    /// Waits until an expression is true.
    pub fn wait(&mut self, expression: &str) {
        let until = Instant::now() + PATIENCE;
        let asked = format!("(() => {{ try {{ return !!({expression}) }} catch {{ return false }} }})()");
        while Instant::now() < until {
            // In the midst of a navigation there is nothing to ask, or nobody.
            let answer = self.ask("Runtime.evaluate", json!({"expression": asked, "returnByValue": true}));
            if answer.is_ok_and(|answer| answer["result"]["value"] == true) {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let text = self.eval("document.body.innerText");
        panic!("never: {expression}; {:?}; {text}", self.errors);
    }

    /// As a device with this screen would show it.
    pub fn resize(&mut self, width: u32, height: u32, scheme: &str, touch: bool) {
        let screen = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": touch});
        self.call("Emulation.setDeviceMetricsOverride", screen);
        self.call("Emulation.setTouchEmulationEnabled", json!({"enabled": touch, "maxTouchPoints": 2}));
        let features = json!([{"name": "prefers-color-scheme", "value": scheme}]);
        self.call("Emulation.setEmulatedMedia", json!({"features": features}));
    }

    /// A key goes down, or up.
    pub fn key(&mut self, code: &str, key: &str, down: bool) {
        let kind = if down { "keyDown" } else { "keyUp" };
        self.call("Input.dispatchKeyEvent", json!({"type": kind, "code": code, "key": key}));
    }

    /// A key that does something by itself, with the number that it has for the browser, goes down and up.
    pub fn press(&mut self, key: &str, number: u32) {
        for kind in ["keyDown", "keyUp"] {
            let text = if key == "Enter" { "\r" } else { "" };
            let event =
                json!({"type": kind, "code": key, "key": key, "text": text, "windowsVirtualKeyCode": number});
            self.call("Input.dispatchKeyEvent", event);
        }
    }

    /// The mouse does something.
    pub fn mouse(&mut self, kind: &str, x: f64, y: f64) {
        let button = if kind == "mouseMoved" { "none" } else { "left" };
        let params = json!({"type": kind, "x": x, "y": y, "button": button, "buttons": 1, "clickCount": 1});
        self.call("Input.dispatchMouseEvent", params);
    }

    /// Fingers do something.
    pub fn touch(&mut self, kind: &str, points: &[[f64; 2]]) {
        let points: Vec<Value> = points.iter().map(|[x, y]| json!({"x": x, "y": y})).collect();
        self.call("Input.dispatchTouchEvent", json!({"type": kind, "touchPoints": points}));
    }

    /// What it looks like, as a file.
    pub fn screenshot(&mut self, file: &Path, format: &str) {
        let answer = self.call("Page.captureScreenshot", json!({"format": format}));
        let bytes = STANDARD.decode(answer["data"].as_str().expect("a picture")).expect("base64");
        fs::write(file, bytes).expect("a file");
    }
}
