//! Those who should not get in, and those who behave badly once they are.

use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::json;
use tungstenite::Message;

use super::served::Served;

#[test]
fn only_the_server_s_own_page_gets_through_and_only_with_the_token() {
    let served = Served::start("--watch-token");
    let own = format!("127.0.0.1:{}", served.port);
    let origin = format!("http://{own}");
    for (host, origin) in [
        (own.as_str(), None),
        (own.as_str(), Some("http://evil.example")),
        (own.as_str(), Some("null")),
        ("evil.example", Some("http://evil.example")),
        ("evil.example", Some(origin.as_str())),
    ] {
        match served.socket(host, origin).map_err(|e| *e) {
            Err(tungstenite::Error::Http(answer)) => assert_eq!(answer.status(), 403, "{host} {origin:?}"),
            Err(e) => panic!("{host} {origin:?}: {e}"),
            Ok(_) => panic!("{host} {origin:?} is let in"),
        }
    }
    assert!(served.get("/", "Host: evil.example").starts_with("HTTP/1.1 403"));
    assert!(served.get("/", "X-No: host").starts_with("HTTP/1.1 4"));
    let page = served.get("/", &format!("Host: {own}"));
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("frame-ancestors 'none'"), "{page}");
    assert!(page.contains("nosniff") && !page.contains(&served.token));
    assert!(served.get("/../Cargo.toml", &format!("Host: {own}")).starts_with("HTTP/1.1 404"));

    let mut stranger = served.hello("AAAAAAAAAAAAAAAAAAAAAA");
    assert_eq!(stranger.hears("bye")["why"], "token");
    assert_eq!(stranger.closed(), Some(1008));
    let mut old = served.viewer();
    old.say(&json!({"type": "hello", "v": 0, "token": served.token}));
    assert_eq!(old.hears("bye")["why"], "version");
    // Who may look does not drive, even where nobody else does.
    let mut watcher = served.hello(served.watch.as_deref().expect("a token"));
    let welcome = watcher.hears("welcome");
    assert_eq!((&welcome["role"], &welcome["may_drive"]), (&json!("watches"), &json!(false)));
    watcher.hears("values");
    watcher.say(&json!({"type": "do", "name": "take"}));
    watcher.say(&json!({"type": "set", "key": "exposure", "value": -5.0}));
    // The next that is set is what somebody else sets.
    let mut driver = served.hello(&served.token);
    assert_eq!(driver.hears("welcome")["role"], "drives");
    driver.say(&json!({"type": "set", "key": "exposure", "value": -1.0}));
    assert_eq!(watcher.hears("values")["values"]["exposure"], -1.0);
    assert!(!served.said().contains("AAAAAAAAAAAA"), "tokens are not logged");
}

#[test]
fn bad_manners_end_a_connection_and_nothing_else() {
    let served = Served::start("");
    let mut honest = served.hello(&served.token);
    honest.hears("welcome");
    honest.sees(|_| true);
    for (what, code) in [
        (Message::text("no JSON"), Some(1008)),
        (Message::binary(vec![0; 16]), Some(1008)),
        (Message::text("x".repeat(6000)), Some(1008)),
    ] {
        let mut rude = served.hello(&served.token);
        rude.hears("welcome");
        rude.socket.send(what).expect("sent");
        assert_eq!(rude.closed(), code);
    }
    // Too long for the protocol.
    let mut rude = served.hello(&served.token);
    rude.hears("welcome");
    let _ = rude.socket.send(Message::binary(vec![0; 1 << 20]));
    rude.closed();
    let mut flood = served.hello(&served.token);
    flood.hears("welcome");
    for _ in 0..100 {
        flood.say(&json!({"type": "do", "name": "take"}));
    }
    flood.closed();
    honest.say(&json!({"type": "set", "key": "exposure", "value": -1.0}));
    while honest.hears("values")["values"]["exposure"] != -1.0 {}
    honest.sees(|flags| flags == 3);
}

#[test]
fn who_reads_nothing_is_left_behind_and_memory_stays() {
    let served = Served::start("--fps 30");
    let mut honest = served.hello(&served.token);
    honest.hears("welcome");
    honest.sees(|_| true);
    let mut stalled: Vec<_> = (0..3).map(|_| served.hello(&served.token)).collect();
    let before = served.memory();
    // Each view is another picture; who does not say that it was drawn has two of them.
    for i in 0..60 {
        let stops = f64::from(i % 8) * 0.5 - 2.0;
        let number = honest.number;
        honest.say(&json!({"type": "set", "key": "exposure", "value": stops}));
        while honest.number == number {
            honest.sees(|_| true);
        }
    }
    let after = served.memory();
    assert!(after < before + (24 << 20), "{before} bytes before, {after} after");
    let mut frames = 0;
    let until = Instant::now() + Duration::from_secs(2);
    stalled[0].socket.get_ref().set_read_timeout(Some(Duration::from_millis(300))).expect("a timeout");
    while let Ok(message) = stalled[0].socket.read()
        && Instant::now() < until
    {
        frames += usize::from(message.is_binary());
    }
    assert_eq!(frames, 2);
}

#[test]
fn there_is_an_end_to_connections_and_room_again_once_they_end() {
    let served = Served::start("");
    let own = format!("Host: 127.0.0.1:{}", served.port);
    let mut held: Vec<_> = (0..8).map(|_| served.viewer()).collect();
    assert_eq!(served.get("/", &own), "", "a ninth of one address");
    held.pop();
    let until = Instant::now() + Duration::from_secs(20);
    while !served.get("/", &own).starts_with("HTTP/1.1 200") {
        assert!(Instant::now() < until, "there is room again");
        std::thread::sleep(Duration::from_millis(20));
    }
    drop(held);
    // Behind a proxy all come from one address; 64 of them, and no more.
    let proxied = Served::start("--behind-proxy");
    let connect = || TcpStream::connect(("127.0.0.1", proxied.port)).expect("it listens");
    let crowd: Vec<_> = (0..64).map(|_| connect()).collect();
    let host = format!("Host: 127.0.0.1:{}", proxied.port);
    assert_eq!(proxied.get("/", &host), "", "a sixty-fifth");
    // Who says nothing is not waited for.
    let until = Instant::now() + Duration::from_secs(60);
    while !proxied.get("/", &host).starts_with("HTTP/1.1 200") {
        assert!(Instant::now() < until, "silent connections end");
        std::thread::sleep(Duration::from_millis(100));
    }
    drop(crowd);
    // Coming and going leaves nothing behind.
    let visit = || {
        let mut viewer = served.hello(&served.token);
        viewer.hears("welcome");
        viewer.sees(|_| true);
    };
    (0..50).for_each(|_| visit());
    let before = served.memory();
    (0..250).for_each(|_| visit());
    let after = served.memory();
    assert!(after < before + (5 << 20), "{before} bytes before, {after} after");
}
