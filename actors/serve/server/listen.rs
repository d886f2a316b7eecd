//! Accepts connections, so many at most, and answers requests: the page's files, and the WebSocket.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Extension, State};
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc::{self, Sender, UnboundedSender};
use tokio::time::timeout;

use super::connection::connection;
use super::still::still;
use super::{Message, Tls};
use crate::gate::Hosts;
use crate::page;
use crate::protocol::INPUT_MAX;

/// Connections at once, of all and of one address.
const CONNECTIONS: usize = 64;
const OF_ADDRESS: usize = 8;
/// Longest that a request may take to arrive.
const REQUEST: Duration = Duration::from_secs(5);

/// What answers requests.
pub(super) struct Door {
    pub hosts: Hosts,
    behind_proxy: bool,
    tls: Option<Tls>,
    pub hub: Sender<Message>,
    connected: AtomicU64,
}

impl Door {
    pub(super) fn new(hosts: Hosts, behind_proxy: bool, tls: Option<Tls>, hub: Sender<Message>) -> Arc<Self> {
        Arc::new(Self { hosts, behind_proxy, tls, hub, connected: AtomicU64::new(0) })
    }

    /// Whose request it is that came from `address`: behind a proxy that one says it.
    pub(super) fn speaks_for(&self, headers: &HeaderMap, address: IpAddr) -> IpAddr {
        if !self.behind_proxy {
            return address;
        }
        // The proxy adds whom it speaks for at the end.
        let forwarded = header(headers, "x-forwarded-for");
        forwarded.rsplit(',').next().and_then(|last| last.trim().parse().ok()).unwrap_or(address)
    }
}

/// A connection, counted as long as anybody holds it.
pub(super) struct Counted {
    pub address: IpAddr,
    over: UnboundedSender<IpAddr>,
}

impl Drop for Counted {
    fn drop(&mut self) {
        let _ = self.over.send(self.address);
    }
}

/// Accepts connections until the server ends.
pub(super) async fn listen(listener: TcpListener, door: Arc<Door>) {
    // (No longer than there are connections.)
    let (over, mut ended) = mpsc::unbounded_channel();
    let mut counts: BTreeMap<IpAddr, usize> = BTreeMap::new();
    let of_address = if door.behind_proxy { CONNECTIONS } else { OF_ADDRESS };
    loop {
        tokio::select! {
            Some(address) = ended.recv() => {
                if let Some(count) = counts.get_mut(&address) {
                    *count -= 1;
                }
                counts.retain(|_, count| *count > 0);
            }
            accepted = listener.accept() => {
                let (stream, peer) = match accepted {
                    Ok(accepted) => accepted,
                    Err(e) => {
                        // As where there are no more file descriptors.
                        tracing::warn!("a connection was lost: {e}");
                        tokio::time::sleep(Duration::from_millis(50)).await;
                        continue;
                    }
                };
                let address = peer.ip().to_canonical();
                if counts.values().sum::<usize>() >= CONNECTIONS
                    || counts.get(&address).is_some_and(|count| *count >= of_address)
                {
                    continue;
                }
                *counts.entry(address).or_default() += 1;
                let counted = Arc::new(Counted { address, over: over.clone() });
                let _ = stream.set_nodelay(true);
                tokio::spawn(greet(stream, counted, Arc::clone(&door)));
            }
        }
    }
}

/// Agrees on keys, where there are any, and goes on.
async fn greet(stream: TcpStream, counted: Arc<Counted>, door: Arc<Door>) {
    let Some(tls) = &door.tls else { return requests(stream, counted, door).await };
    match timeout(REQUEST, tls.accept(stream)).await {
        Ok(Ok(stream)) => requests(stream, counted, Arc::clone(&door)).await,
        Ok(Err(e)) => tracing::debug!("a connection was not encrypted: {e}"),
        Err(_) => tracing::debug!("a connection was not encrypted in time"),
    }
}

/// Answers the requests of a connection.
async fn requests<S>(stream: S, counted: Arc<Counted>, door: Arc<Door>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let router = Router::new().route("/walk", get(walk)).route("/still", post(still)).fallback(file);
    let router = router.layer(Extension(counted)).with_state(door);
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(REQUEST)
        .max_buf_size(16 << 10)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .with_upgrades()
        .await;
    if let Err(e) = served {
        tracing::debug!("a connection ended: {e}");
    }
}

pub(super) fn header(headers: &HeaderMap, name: impl axum::http::header::AsHeaderName) -> &str {
    headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default()
}

/// What every answer says to a browser.
pub(super) fn answer(status: StatusCode, kind: &'static str, body: impl Into<Body>) -> Response {
    let headers = [
        ("content-type", kind),
        ("content-security-policy", page::POLICY),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-opener-policy", "same-origin"),
        ("cross-origin-resource-policy", "same-origin"),
        ("cache-control", "no-cache"),
    ];
    (status, headers, body.into()).into_response()
}

pub(super) fn refused(why: &'static str) -> Response {
    answer(StatusCode::FORBIDDEN, "text/plain; charset=utf-8", why)
}

/// A file of the page.
async fn file(State(door): State<Arc<Door>>, method: Method, uri: Uri, headers: HeaderMap) -> Response {
    if !door.hosts.knows(header(&headers, HOST)) {
        return refused("this name is not served; --host allows it\n");
    }
    if method != Method::GET && method != Method::HEAD {
        return answer(StatusCode::METHOD_NOT_ALLOWED, "text/plain; charset=utf-8", "GET only\n");
    }
    match page::file(uri.path()) {
        Some(page::File { kind, bytes }) => answer(StatusCode::OK, kind, bytes),
        None => answer(StatusCode::NOT_FOUND, "text/plain; charset=utf-8", "there is nothing\n"),
    }
}

/// The WebSocket of a page that this server gave out.
async fn walk(
    State(door): State<Arc<Door>>,
    Extension(counted): Extension<Arc<Counted>>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !door.hosts.is_own(header(&headers, HOST), header(&headers, ORIGIN)) {
        return refused("only this server's own page may walk\n");
    }
    let address = door.speaks_for(&headers, counted.address);
    let id = door.connected.fetch_add(1, Ordering::Relaxed);
    let hub = door.hub.clone();
    upgrade.max_message_size(INPUT_MAX).max_frame_size(INPUT_MAX).on_upgrade(move |socket| async move {
        connection(socket, id, address, hub).await;
        drop(counted);
    })
}
