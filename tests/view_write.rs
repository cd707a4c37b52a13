//! Viewers that may change parameters, over real sockets: which parameters, which origins, and what
//! all viewers see.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};

use downwash::clock::HostTime;
use downwash::offboard::{Adjusted, Adjustment};
use downwash::station::Status;
use downwash::view::{CoursePath, LiveFeed, LiveView, ViewSettings};
use serde_json::{Value, json};
use vehicle::frame::Ned;

use crate::viewer::{ServerMessage, Viewer};

const NAMES: [&str; 4] =
    ["flight.goal_north_m", "flight.goal_east_m", "flight.goal_up_m", "flight.feedback_scale"];

fn start(is_writable: bool) -> (LiveView, LiveFeed) {
    let parameters: BTreeMap<_, _> = [("control.rate_hz".to_owned(), "100.0".to_owned())].into();
    let address = "127.0.0.1:0".to_owned();
    let settings = ViewSettings { address, parameters, is_writable, ..ViewSettings::default() };
    LiveView::start(settings, &[], CoursePath::default()).expect("a view")
}

/// The server's first message.
fn server_info(view: &LiveView) -> Value {
    match Viewer::connect(view.address()).receive() {
        ServerMessage::Json(info) => info,
        other => panic!("{other:?}"),
    }
}

/// The parameter values in the next message that reports them.
fn values(viewer: &mut Viewer) -> BTreeMap<String, f64> {
    loop {
        if let ServerMessage::Json(said) = viewer.receive()
            && said["op"] == "parameterValues"
        {
            let pair = |p: &Value| Some((p["name"].as_str()?.to_owned(), p["value"].as_f64()?));
            return said["parameters"]
                .as_array()
                .expect("a list")
                .iter()
                .filter_map(pair)
                .collect();
        }
    }
}

/// Sets parameters; returns the server's answer, which follows their acceptance.
fn set(viewer: &mut Viewer, parameters: Value) -> BTreeMap<String, f64> {
    viewer.send(json!({"op": "setParameters", "id": "set", "parameters": parameters}));
    values(viewer)
}

fn number(name: &str, value: impl Into<Value>) -> Value {
    json!({"name": name, "value": value.into(), "type": "float64"})
}

#[test]
fn read_only_view_offers_and_accepts_no_changes() {
    let (view, _feed) = start(false);
    assert!(server_info(&view)["metadata"].get("writable").is_none());
    assert!(view.take_changes().is_none());
    let mut viewer = Viewer::ready(view.address(), "/status");
    let said = set(&mut viewer, json!([number(NAMES[0], 1.0), number("control.rate_hz", 5.0)]));
    assert_eq!(said, [("control.rate_hz".to_owned(), 100.0)].into());
}

#[test]
fn change_is_forwarded_whole_and_shown_to_all_viewers() {
    let (view, _feed) = start(true);
    let changes = view.take_changes().expect("changes");
    assert_eq!(server_info(&view)["metadata"]["writable"], NAMES.join(" "));
    let mut asking = Viewer::ready(view.address(), "/status");
    let mut watching = Viewer::ready(view.address(), "/status");
    for viewer in [&mut asking, &mut watching] {
        viewer.send(json!({"op": "subscribeParameterUpdates", "parameterNames": NAMES}));
        viewer.send(json!({"op": "getParameters", "id": "now", "parameterNames": NAMES}));
        assert_eq!(values(viewer)["flight.feedback_scale"], 1.0);
    }
    // An untyped integer is a number too.
    let up = json!({"name": "flight.goal_up_m", "value": 1});
    let said = set(&mut asking, json!([number("flight.goal_north_m", 0.5), up]));
    assert_eq!(said["flight.goal_north_m"], 0.0, "the value in force, not the requested one");
    let expected = Adjustment { north_m: Some(0.5), up_m: Some(1.0), ..Adjustment::default() };
    assert_eq!(changes.take(), Some(expected));
    assert_eq!(changes.take(), None);

    let adjusted = Adjusted { goal: Ned::new(0.5, 0.0, -1.0), feedback_scale: 1.0 };
    view.show(HostTime::default(), &Status { adjusted, ..Status::default() });
    for viewer in [&mut asking, &mut watching] {
        let said = values(viewer);
        assert_eq!((said["flight.goal_north_m"], said["flight.goal_up_m"]), (0.5, 1.0));
    }
}

#[test]
fn unlisted_or_non_numeric_parameters_change_nothing() {
    let (view, _feed) = start(true);
    let changes = view.take_changes().expect("changes");
    let mut viewer = Viewer::ready(view.address(), "/status");
    for wrong in [
        json!([number("control.rate_hz", 5.0)]),
        json!([number("flight.goal", 1.0)]),
        json!([{"name": "flight.goal_north_m", "value": "north"}]),
        json!([{"name": "flight.goal_north_m", "value": [1.0]}]),
        json!([{"name": "flight.goal_north_m", "value": {"x": 1.0}}]),
        json!([{"name": "flight.goal_north_m", "value": true}]),
        json!([{"name": "flight.goal_north_m"}]),
        json!([]),
    ] {
        set(&mut viewer, wrong.clone());
        assert_eq!(changes.take(), None, "{wrong}");
    }
}

#[test]
fn repeated_changes_are_bounded() {
    let (view, _feed) = start(true);
    let changes = view.take_changes().expect("changes");
    let mut viewer = Viewer::ready(view.address(), "/status");
    for turn in 0..1000 {
        set(&mut viewer, json!([number("flight.goal_north_m", f64::from(turn))]));
    }
    let taken = std::iter::from_fn(|| changes.take()).count();
    assert_eq!(taken, 4);
}

/// Requests a WebSocket like a page from `origin`; returns the first line of the answer.
fn knock(at: SocketAddr, origin: &str) -> (TcpStream, String) {
    let mut stream = TcpStream::connect(at).expect("connects");
    write!(
        stream,
        "GET / HTTP/1.1\r\nHost: {at}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Origin: {origin}\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
    )
    .expect("asked");
    let mut line = Vec::new();
    let mut byte = [0];
    while stream.read_exact(&mut byte).is_ok() && byte[0] != b'\r' {
        line.push(byte[0]);
    }
    (stream, String::from_utf8_lossy(&line).into_owned())
}

#[test]
fn foreign_origin_is_refused_by_a_writable_view() {
    let (view, _feed) = start(true);
    let at = view.address();
    assert_eq!(knock(at, "https://example.org").1, "HTTP/1.1 403 Forbidden");
    assert_eq!(knock(at, &format!("http://{at}")).1, "HTTP/1.1 101 Switching Protocols");
    let (open, _feed) = start(false);
    assert_eq!(knock(open.address(), "https://example.org").1, "HTTP/1.1 101 Switching Protocols");
}
