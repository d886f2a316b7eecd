//! Certificates, and what is wrong with them.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use serde_json::{Value, json};

use super::page::STILL;
use super::served::Served;
use crate::support::browser::Browser;
use crate::support::{Foveal, folder, scene};

/// A certificate for this machine and its key.
fn pair() -> [PathBuf; 2] {
    let made =
        rcgen::generate_simple_self_signed(["localhost".to_owned(), "127.0.0.1".into()]).expect("a pair");
    let folder = folder("pair");
    let [certificate, key] = ["cert.pem", "key.pem"].map(|name| folder.join(name));
    fs::write(&certificate, made.cert.pem()).expect("a file");
    fs::write(&key, made.signing_key.serialize_pem()).expect("a file");
    [certificate, key]
}

fn served(certificate: &Path, key: &Path, words: &str) -> Served {
    let words = format!("{words} --tls-cert {} --tls-key {}", certificate.display(), key.display());
    Served::start(&format!("--refine 0 {words}"))
}

/// A connection of somebody who trusts this certificate and nobody else.
fn connect(certificate: &Path, port: u16) -> StreamOwned<ClientConnection, TcpStream> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(certificate).expect("a certificate")).expect("a root");
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
    let config = config.expect("versions").with_root_certificates(roots).with_no_client_auth();
    let name = ServerName::try_from("localhost").expect("a name");
    let stream = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
    stream.set_read_timeout(Some(std::time::Duration::from_secs(60))).expect("a timeout");
    StreamOwned::new(ClientConnection::new(Arc::new(config), name).expect("a connection"), stream)
}

#[test]
fn a_certificate_encrypts_the_page_and_the_walk() {
    let [certificate, key] = pair();
    let served = served(&certificate, &key, "--listen 0.0.0.0:0 --host localhost");
    assert_eq!(served.base, format!("https://localhost:{}/", served.port));
    let host = format!("localhost:{}", served.port);
    let mut stream = connect(&certificate, served.port);
    write!(stream, "GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").expect("sent");
    let mut page = String::new();
    let _ = stream.read_to_string(&mut page);
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("<canvas"), "{page}");
    // The walk, from the page that came by https and from no other.
    for (origin, is_let_in) in [(format!("https://{host}"), true), ("https://evil.example".into(), false)] {
        let mut request =
            tungstenite::client::IntoClientRequest::into_client_request(format!("wss://{host}/walk"))
                .expect("a request");
        request.headers_mut().insert("Origin", origin.parse().expect("a header"));
        let opened = tungstenite::client(request, connect(&certificate, served.port));
        assert_eq!(opened.is_ok(), is_let_in, "{origin}");
        let Ok((mut socket, _)) = opened else { continue };
        let hello = json!({"type": "hello", "v": 1, "token": served.token}).to_string();
        socket.send(tungstenite::Message::text(hello)).expect("sent");
        let welcome: Value = loop {
            if let tungstenite::Message::Text(text) = socket.read().expect("a message") {
                break serde_json::from_str(&text).expect("JSON");
            }
        };
        assert_eq!((&welcome["type"], &welcome["role"]), (&json!("welcome"), &json!("drives")));
    }
    // Who does not encrypt hears nothing of the page, nor does who trusts somebody else.
    assert!(!served.get("/", &format!("Host: {host}")).contains("canvas"));
    let [other, _] = pair();
    assert!(connect(&other, served.port).write_all(b"GET / HTTP/1.1\r\n\r\n").is_err());
    let Some(browser) = Browser::open() else { return };
    let mut page = browser.page();
    page.call("Security.enable", json!({}));
    page.call("Security.setIgnoreCertificateErrors", json!({"ignore": true}));
    page.go(&format!("{}#t={}", served.base, served.token));
    page.wait(STILL);
    assert_eq!(page.eval("[location.protocol, isSecureContext]"), json!(["https:", true]));
}

#[test]
fn what_is_wrong_with_a_certificate_is_said_with_its_file() {
    let [certificate, key] = pair();
    let [_, other] = pair();
    let folder = certificate.parent().expect("a folder").to_owned();
    let (empty, broken) = (folder.join("empty.pem"), folder.join("broken.pem"));
    fs::write(&empty, "").expect("a file");
    fs::write(&broken, "-----BEGIN CERTIFICATE-----\n????\n-----END CERTIFICATE-----\n").expect("a file");
    let none = folder.join("none.pem");
    let nonsense = folder.join("nonsense.pem");
    fs::write(&nonsense, "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n").expect("a file");
    for (certificate, key, words) in [
        (&none, &key, &["none.pem"][..]),
        (&certificate, &none, &["none.pem"]),
        (&empty, &key, &["empty.pem", "BEGIN CERTIFICATE"]),
        (&broken, &key, &["broken.pem", "PEM"]),
        (&nonsense, &key, &["nonsense.pem"]),
        (&certificate, &certificate, &["cert.pem", "BEGIN PRIVATE KEY"]),
        (&key, &key, &["key.pem", "BEGIN CERTIFICATE"]),
        (&certificate, &other, &["key.pem", "cert.pem", "one pair"]),
    ] {
        let run =
            Foveal::new("serve --listen 127.0.0.1:0 --tls-cert").arg(certificate).arg("--tls-key").arg(key);
        let ended = run.arg(scene("box")).fails(3, words);
        assert_eq!(ended.err.trim().lines().count(), 1, "{}", ended.err);
    }
    let files =
        |run: Foveal| run.arg("--tls-cert").arg(&certificate).arg("--tls-key").arg(&key).arg(scene("box"));
    files(Foveal::new("serve --listen 0.0.0.0:0")).fails(2, &["--host"]);
    files(Foveal::new("serve --behind-proxy")).fails(2, &["--behind-proxy", "cannot be used with"]);
    Foveal::new("serve --tls-cert").arg(&certificate).arg(scene("box")).fails(2, &["--tls-key"]);
}

#[cfg(unix)]
#[test]
fn the_system_s_browser_is_asked_and_missed_without_harm() {
    use std::os::unix::fs::PermissionsExt;
    let folder = folder("opener");
    let (opener, seen) = (folder.join("xdg-open"), folder.join("seen"));
    fs::write(&opener, format!("#!/bin/sh\necho \"$1\" > {}\n", seen.display())).expect("a script");
    fs::set_permissions(&opener, fs::Permissions::from_mode(0o755)).expect("a right");
    let path = std::env::join_paths([folder.clone(), "/bin".into()]).expect("a path");
    let served = Served::with(&scene("box"), "--open", &[("PATH", path.as_os_str())]);
    super::page::until("it is opened", || fs::read_to_string(&seen).is_ok_and(|text| text.ends_with('\n')));
    assert_eq!(fs::read_to_string(&seen).expect("an address").trim(), served.address());
    drop(served);
    let nowhere = folder.join("nowhere");
    let served = Served::with(&scene("box"), "--open", &[("PATH", nowhere.as_os_str())]);
    assert!(served.get("/", &format!("Host: 127.0.0.1:{}", served.port)).contains("canvas"));
    super::page::until("it is said", || served.said().contains("by hand"));
}
