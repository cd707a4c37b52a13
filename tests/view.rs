//! The live view over real sockets, seen by a protocol client.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use downwash::log::LogReader;
use downwash::log::record::{Record, Tick};
use downwash::log::schema::{ControlMessage, Flat, StateMessage};
use downwash::log::sink::Listener;
use downwash::view::{CoursePath, LiveFeed, LiveView, ViewSettings};
use prost::Message;
use serde_json::json;
use vehicle::frame::Ned;

use crate::log_flight::{records, run_info, write};
use crate::viewer::{Data, ServerMessage, Viewer};

fn start(course: CoursePath) -> (LiveView, LiveFeed) {
    let parameters = [("control.law", "lqr"), ("control.rate_hz", "100.0")];
    let settings = ViewSettings {
        address: "127.0.0.1:0".to_owned(),
        name: "test".to_owned(),
        parameters: parameters.map(|(name, value)| (name.to_owned(), value.to_owned())).into(),
        ..ViewSettings::default()
    };
    LiveView::start(settings, &run_info().rotors, course).expect("a view")
}

fn hear_all(feed: &mut LiveFeed, records: &[Record]) {
    records.iter().for_each(|record| feed.on_record(record));
}

/// A marker event that ends what was published before it.
fn event(text: &str) -> Record {
    let mut event = records(0.01).remove(0);
    if let Record::Event { text: words, .. } = &mut event {
        *words = text.to_owned();
    }
    event
}

/// The messages up to the event `text`.
fn until(viewer: &mut Viewer, text: &str) -> Vec<Data> {
    let mut found = Vec::new();
    loop {
        let data = viewer.data();
        let is_last = data.topic == "/log"
            && data.body.windows(text.len()).any(|part| part == text.as_bytes());
        found.push(data);
        if is_last {
            return found;
        }
    }
}

#[test]
fn viewers_get_log_bytes_of_subscribed_topics_only() {
    let (view, mut feed) = start(CoursePath::default());
    let topics = ["/state", "/control", "/imu", "/vehicle/pose", "/log"];
    let mut viewer = Viewer::ready(view.address(), "/status");
    viewer.subscribe(&topics);
    let flight = records(1.5);
    hear_all(&mut feed, &flight);
    feed.on_record(&event("that is all"));
    let mut seen = until(&mut viewer, "that is all");
    seen.pop();

    let folder = std::env::temp_dir().join(format!("downwash-view-{}", std::process::id()));
    let log = write(&folder, &flight);
    let mut reader = LogReader::open(&log).expect("a log");
    let mut logged = Vec::new();
    while let Some(message) = reader.next_message().expect("readable") {
        if topics.contains(&message.channel.topic.as_str()) {
            let (topic, time) = (message.channel.topic.clone(), message.log_time.as_ns());
            logged.push(Data { topic, time, body: message.data.to_vec() });
        }
    }
    std::fs::remove_dir_all(&folder).expect("removed");
    assert!(logged.len() > 700);
    let differs = seen.iter().zip(&logged).position(|(seen, logged)| seen != logged);
    let differs = differs.map(|at| (at, &seen[at], &logged[at]));
    assert_eq!((differs, seen.len()), (None, logged.len()));
    let state = StateMessage::decode(&*seen.iter().find(|d| d.topic == "/state").unwrap().body);
    assert!(state.expect("protobuf").vehicle_time_us > 0);
}

#[test]
fn viewer_receives_server_info_schemas_time_and_parameters() {
    let (view, mut feed) = start(CoursePath::default());
    let mut viewer = Viewer::connect(view.address());
    let ServerMessage::Json(info) = viewer.receive() else { panic!("no serverInfo") };
    assert_eq!((&info["op"], &info["name"]), (&json!("serverInfo"), &json!("test")));
    assert_eq!(info["capabilities"], json!(["time", "parameters", "parametersSubscribe"]));
    let ServerMessage::Json(advertise) = viewer.receive() else { panic!("no topics") };
    let channels = advertise["channels"].as_array().expect("channels");
    assert!(channels.iter().all(|channel| channel["encoding"] == "protobuf"));
    let control = channels.iter().find(|c| c["topic"] == "/control").expect("/control");
    assert_eq!(control["schemaName"], ControlMessage::NAME);

    viewer.send(json!({"op": "getParameters", "id": "all", "parameterNames": []}));
    let ServerMessage::Json(answer) = viewer.receive() else { panic!("no parameters") };
    assert_eq!(answer["parameters"][0], json!({"name": "control.law", "value": "lqr"}));
    // A parameter set from outside keeps its value.
    let set = json!({"name": "control.rate_hz", "value": 5.0, "type": "float64"});
    viewer.send(json!({"op": "setParameters", "id": "set", "parameters": [set]}));
    let ServerMessage::Json(answer) = viewer.receive() else { panic!("no answer") };
    assert_eq!(answer["parameters"][0]["value"], 100.0);

    viewer.subscribe(&["/state"]);
    let facts = [("parameter.MPC_XY_P", "0.95"), ("firmware", "1.15")];
    let facts = facts.map(|(name, value)| (name.to_owned(), value.to_owned()));
    feed.on_record(&Record::Facts(Box::new(facts.into())));
    hear_all(&mut feed, &records(0.5));
    let times: Vec<u64> = std::iter::repeat_with(|| viewer.receive())
        .filter_map(
            |message| if let ServerMessage::Time(time) = message { Some(time) } else { None },
        )
        .take(3)
        .collect();
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] >= 100_000_000), "{times:?}");
    viewer
        .send(json!({"op": "getParameters", "id": "p", "parameterNames": ["parameter.MPC_XY_P"]}));
    loop {
        if let ServerMessage::Json(answer) = viewer.receive() {
            assert_eq!(answer["parameters"][0]["value"], 0.95);
            break;
        }
    }
}

#[test]
fn late_viewer_receives_vehicle_plan_trail_and_events() {
    let course = CoursePath { period_s: 1.0, points: vec![Ned::zero(); 20], tube: Vec::new() };
    let (view, mut feed) = start(course);
    let mut flight = records(10.0);
    for record in &mut flight {
        if let Record::Tick(Tick { desired, reference: Some(reference), .. }) = record {
            *desired = Some(reference.position);
        }
    }
    let (before, after) = flight.split_at(flight.len() / 2);
    hear_all(&mut feed, before);
    let mut viewer = Viewer::ready(view.address(), "/status");
    viewer.subscribe(&["/scene", "/log"]);
    hear_all(&mut feed, &after[..200]);
    feed.on_record(&event("that is all"));
    let seen = until(&mut viewer, "that is all");
    let shows = |text: &str| {
        seen.iter().any(|data| data.body.windows(text.len()).any(|part| part == text.as_bytes()))
    };
    for text in ["base_link_ref", "trail", "plan", "armed", "Low battery"] {
        assert!(shows(text), "{text}");
    }
}

#[test]
fn stalled_viewer_loses_messages_without_blocking_others() {
    let (view, mut feed) = start(CoursePath::default());
    let topics = ["/mavlink/rx", "/state", "/log"];
    let mut stalled = Viewer::ready(view.address(), "/status");
    stalled.keep_little();
    stalled.subscribe(&topics);
    let mut reading = Viewer::ready(view.address(), "/status");
    reading.subscribe(&topics);
    let part = records(0.4);
    let mut fed = 0;
    for turn in 0..300 {
        hear_all(&mut feed, &part);
        let end = format!("turn {turn} ends");
        feed.on_record(&event(&end));
        let seen = until(&mut reading, &end).len();
        assert!(turn == 0 || fed / turn == seen, "the other viewer loses nothing");
        fed += seen;
    }
    let seen = until(&mut stalled, "turn 299 ends");
    assert!(seen.len() < fed / 2, "{} of {fed}", seen.len());
    assert!(seen.len() > 500, "{}", seen.len());
}

/// A million bytes of garbage (xorshift64).
fn garbage() -> Vec<u8> {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as u8
    };
    std::iter::repeat_with(next).take(1_000_000).collect()
}

#[test]
fn garbage_ends_only_its_own_connection() {
    let (view, mut feed) = start(CoursePath::default());
    let mut watching = Viewer::ready(view.address(), "/status");
    watching.subscribe(&["/log"]);
    let garbage = garbage();
    // Raw, after a handshake, and as messages.
    let mut raw = TcpStream::connect(view.address()).expect("connects");
    let _ = raw.write_all(&garbage);
    let mut upgraded = TcpStream::connect(view.address()).expect("connects");
    let _ = upgraded.write_all(
        b"GET / HTTP/1.1\r\nHost: a\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
          Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
          Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n",
    );
    let _ = upgraded.write_all(&garbage);
    let mut speaking = Viewer::connect(view.address());
    for bytes in garbage.chunks(500) {
        if speaking.send_bytes(bytes.to_vec()).is_err() {
            break;
        }
    }
    let mut texts = Viewer::connect(view.address());
    for op in ["subscribe", "unsubscribe", "advertise", "setParameters", "playbackControl", "?"] {
        for (wrong, id) in
            [(json!(1), json!({})), (json!([{}]), json!([0])), (json!(-1), json!(1e99))]
        {
            let items = json!({"op": op, "subscriptions": wrong, "parameters": id, "id": id});
            texts.send(items);
        }
    }
    feed.on_record(&event("still here"));
    assert_eq!(until(&mut watching, "still here").len(), 1);
    let mut newcomer = Viewer::ready(view.address(), "/status");
    newcomer.subscribe(&["/state"]);
}

fn get(address: SocketAddr, path: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("connects");
    stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a limit");
    write!(stream, "GET {path} HTTP/1.1\r\nHost: a\r\n\r\n").expect("asked");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("answered");
    answer
}

#[test]
fn page_is_served_on_the_same_port_without_external_requests() {
    let (view, _feed) = start(CoursePath::default());
    let page = get(view.address(), "/");
    let (head, page) = page.split_once("\r\n\r\n").expect("a head");
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n"), "{head}");
    assert!(head.contains("Content-Security-Policy: default-src 'none'"));
    assert!(page.starts_with("<!doctype html>"));
    for outside in ["http://", "https://", "//cdn", "@import", "src=\""] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(get(view.address(), "/etc/passwd").starts_with("HTTP/1.1 404"));
}

#[test]
fn connections_are_limited_and_slots_are_freed() {
    let (view, _feed) = start(CoursePath::default());
    let idle: Vec<_> = (0..32).map(|_| TcpStream::connect(view.address())).collect();
    let mut turned_away = TcpStream::connect(view.address()).expect("connects");
    let mut byte = [0];
    assert!(!matches!(turned_away.read(&mut byte), Ok(1..)));
    drop(idle);
    // The server notices later that they have gone.
    let is_served = (0..).any(|_| {
        let mut stream = TcpStream::connect(view.address()).expect("connects");
        let _ = stream.write_all(b"GET / HTTP/1.1\r\n\r\n");
        matches!(stream.read(&mut byte), Ok(1))
    });
    assert!(is_served);
}

#[test]
fn taken_port_error_suggests_another() {
    let (view, _feed) = start(CoursePath::default());
    let settings = ViewSettings { address: view.address().to_string(), ..Default::default() };
    let error = LiveView::start(settings, &[], CoursePath::default()).err().expect("taken");
    assert!(error.to_string().contains("choose another with --view=HOST:PORT"), "{error}");
}
