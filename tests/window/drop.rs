//! A file is dropped on the window: the protocol of drag and drop between programs (XDND 5), as a file manager speaks it.

use std::path::Path;
use std::time::{Duration, Instant};

use x11rb::connection::Connection;
use x11rb::protocol::Event;
use x11rb::protocol::xproto::{
    AtomEnum, ClientMessageEvent, ConnectionExt, CreateWindowAux, EventMask, PropMode,
    SELECTION_NOTIFY_EVENT, SelectionNotifyEvent, WindowClass,
};
use x11rb::rust_connection::RustConnection;
use x11rb::wrapper::ConnectionExt as _;

use super::driver::{Display, PATIENCE, View};
use crate::support::{root, scene};

/// Drops `file` in the middle of `target`'s picture.
fn drop_file(display: &str, target: u32, file: &Path) {
    let (connection, screen) = RustConnection::connect(Some(display)).expect("the display");
    let root = connection.setup().roots[screen].root;
    let atom = |name: &str| {
        let cookie = connection.intern_atom(false, name.as_bytes()).expect("asked");
        cookie.reply().expect("an atom").atom
    };
    let (list, selection, copy) = (atom("text/uri-list"), atom("XdndSelection"), atom("XdndActionCopy"));
    let (status, finished) = (atom("XdndStatus"), atom("XdndFinished"));
    let source = connection.generate_id().expect("an id");
    let nothing = CreateWindowAux::new();
    connection
        .create_window(0, source, root, 0, 0, 1, 1, 0, WindowClass::INPUT_ONLY, 0, &nothing)
        .expect("a window");
    connection.set_selection_owner(source, selection, x11rb::CURRENT_TIME).expect("owned");
    let say = |kind: &str, data: [u32; 5]| {
        let message = ClientMessageEvent::new(32, target, atom(kind), data);
        connection.send_event(false, target, EventMask::NO_EVENT, message).expect("sent");
        connection.flush().expect("flushed");
    };
    say("XdndEnter", [source, 5 << 24, list, 0, 0]);
    say("XdndPosition", [source, 0, (100 << 16) | 100, x11rb::CURRENT_TIME, copy]);
    let (start, mut dropped) = (Instant::now(), false);
    loop {
        assert!(start.elapsed() < PATIENCE, "nobody takes the file");
        let Some(event) = connection.poll_for_event().expect("an event") else {
            std::thread::sleep(Duration::from_millis(5));
            continue;
        };
        match event {
            Event::SelectionRequest(asked) => {
                let uri = format!("file://{}\r\n", file.display());
                connection
                    .change_property8(
                        PropMode::REPLACE,
                        asked.requestor,
                        asked.property,
                        list,
                        uri.as_bytes(),
                    )
                    .expect("given");
                let answer = SelectionNotifyEvent {
                    response_type: SELECTION_NOTIFY_EVENT,
                    sequence: 0,
                    time: asked.time,
                    requestor: asked.requestor,
                    selection: asked.selection,
                    target: asked.target,
                    property: if asked.target == list { asked.property } else { AtomEnum::NONE.into() },
                };
                connection.send_event(false, asked.requestor, EventMask::NO_EVENT, answer).expect("sent");
                connection.flush().expect("flushed");
            }
            Event::ClientMessage(m) if m.type_ == status && !dropped => {
                dropped = true;
                say("XdndDrop", [source, 0, x11rb::CURRENT_TIME, 0, 0]);
            }
            Event::ClientMessage(m) if m.type_ == finished => return,
            _ => {}
        }
    }
}

#[test]
fn a_scene_that_is_dropped_on_the_window_is_shown() {
    let Some(display) = Display::open() else { return };
    let mut view = View::open(&display, "--backend cpu", &scene("box"), &[]);
    let first = view.converged();
    let window: u32 = view.window.parse().expect("a number");
    drop_file(&display.name, window, &scene("table"));
    let start = Instant::now();
    while view.shot().fact("foveal scene") == first.fact("foveal scene") {
        assert!(start.elapsed() < PATIENCE, "the scene is still the first");
    }
    assert!(view.shot().fact("foveal scene").starts_with("table"));

    // What is no scene leaves the one that is there.
    drop_file(&display.name, window, &root().join("scenes/README.md"));
    while !view.complains() {
        assert!(start.elapsed() < PATIENCE, "no error in the window");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(view.shot().fact("foveal scene").starts_with("table"));
    view.quit();
}
