//! One connection: what it says goes to the hub, what the hub says goes to it.

use std::net::IpAddr;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message as Frame, WebSocket};
use tokio::sync::mpsc::{self, Sender};
use tokio::time::timeout;

use super::Message;
use crate::hub::Event;
use crate::viewer::ViewerId;

/// What may wait for a connection.
const WAITING: usize = 16;
/// Longest that a connection may take for one of these.
const SENDING: Duration = Duration::from_secs(20);

/// What is to be sent.
#[derive(Debug)]
pub(super) enum Out {
    Text(String),
    Binary(Vec<u8>),
    Close(u16),
}

/// Serves a connection until it ends. Who has not read what was sent to it is not listened to.
pub(super) async fn connection(mut socket: WebSocket, id: ViewerId, address: IpAddr, hub: Sender<Message>) {
    let (out, mut waiting) = mpsc::channel(WAITING);
    if hub.send(Message::Connected(id, address, out)).await.is_err() {
        return;
    }
    loop {
        tokio::select! {
            out = waiting.recv() => {
                let (frame, is_last) = match out {
                    Some(Out::Text(text)) => (Frame::text(text), false),
                    Some(Out::Binary(bytes)) => (Frame::binary(bytes), false),
                    Some(Out::Close(code)) => (close(code), true),
                    // The hub has forgotten it.
                    None => (close(1008), true),
                };
                let sent = timeout(SENDING, socket.send(frame)).await;
                if is_last || !matches!(sent, Ok(Ok(()))) {
                    break;
                }
            }
            heard = socket.recv() => {
                let event = match heard {
                    Some(Ok(Frame::Text(text))) => Event::Text(id, text.as_str().to_owned()),
                    Some(Ok(Frame::Binary(bytes))) => Event::Input(id, bytes.to_vec()),
                    // Pings are answered by the protocol.
                    Some(Ok(Frame::Ping(_) | Frame::Pong(_))) => continue,
                    Some(Err(_)) => {
                        let _ = timeout(SENDING, socket.send(close(1009))).await;
                        break;
                    }
                    Some(Ok(Frame::Close(_))) | None => break,
                };
                if hub.send(Message::Event(event)).await.is_err() {
                    break;
                }
            }
        }
    }
    let _ = hub.send(Message::Event(Event::Gone(id))).await;
}

fn close(code: u16) -> Frame {
    Frame::Close(Some(CloseFrame { code, reason: "".into() }))
}
