//! Playback of a log to viewers, over real sockets.

use downwash::log::LogReader;
use downwash::view::{Playback, Recording, ViewSettings};
use serde_json::json;

use crate::log_flight::{START, records, write};
use crate::viewer::{Data, ServerMessage, Viewer};

const PLAY: u8 = 0;
const PAUSE: u8 = 1;
const PLAYING: u8 = 0;
const PAUSED: u8 = 1;
const ENDED: u8 = 3;

/// A log of three seconds, playing or paused.
fn play(name: &str, is_paused: bool) -> (Playback, Vec<Data>) {
    let folder = std::env::temp_dir().join(format!("downwash-{name}-{}", std::process::id()));
    let log = write(&folder, &records(3.0));
    let mut reader = LogReader::open(&log).expect("a log");
    let mut logged = Vec::new();
    while let Some(message) = reader.next_message().expect("readable") {
        let (topic, time) = (message.channel.topic.clone(), message.log_time.as_ns());
        logged.push(Data { topic, time, body: message.data.to_vec() });
    }
    let recording = Recording::read(LogReader::open(&log).expect("a log")).expect("readable");
    std::fs::remove_dir_all(&folder).expect("removed");
    let settings = ViewSettings { address: "127.0.0.1:0".to_owned(), ..Default::default() };
    (Playback::start(settings, recording, is_paused).expect("a playback"), logged)
}

/// A request in Foxglove's protocol, with a speed and a time to seek to, in s of the log.
fn request(viewer: &mut Viewer, command: u8, speed: f32, seek: Option<f64>) {
    let mut bytes = vec![3, command];
    bytes.extend(speed.to_le_bytes());
    bytes.push(seek.is_some().into());
    bytes.extend(seek.map_or(0, ns).to_le_bytes());
    bytes.extend(4u32.to_le_bytes());
    bytes.extend(b"test");
    viewer.send_bytes(bytes).expect("sent");
}

fn ns(s: f64) -> u64 {
    START.as_ns() + (s * 1e9).round() as u64
}

/// Everything up to a state of the playback, and that state.
fn until(viewer: &mut Viewer, status: u8) -> (Vec<Data>, (u64, f32, bool)) {
    let mut found = Vec::new();
    loop {
        match viewer.receive() {
            ServerMessage::Data(data) => found.push(data),
            ServerMessage::Playback(is, time, speed, has_sought) if is == status => {
                return (found, (time, speed, has_sought));
            }
            _ => {}
        }
    }
}

#[test]
fn log_is_played_to_its_end_without_a_gap() {
    let (playback, logged) = play("played", true);
    let mut viewer = Viewer::connect(playback.address());
    let ServerMessage::Json(info) = viewer.receive() else { panic!("no serverInfo") };
    assert!(info["capabilities"].as_array().expect("a list").contains(&json!("playbackControl")));
    assert_eq!(info["dataStartTime"]["sec"], START.as_ns() / 1_000_000_000);
    while !viewer.topics.contains_key("/state") {
        viewer.receive();
    }
    viewer.subscribe(&["/state", "/control"]);
    request(&mut viewer, PLAY, 4.0, None);
    let (mut seen, (time, speed, _)) = until(&mut viewer, ENDED);
    assert_eq!((time, speed), (ns(3.0), 4.0));
    // The messages at the instant where it was paused were sent before any viewer connected.
    let is_wanted =
        |d: &Data| ["/state", "/control"].contains(&d.topic.as_str()) && d.time > START.as_ns();
    let wanted: Vec<_> = logged.into_iter().filter(is_wanted).collect();
    // The state message overtakes queued messages.
    while seen.len() < wanted.len() {
        seen.push(viewer.data());
    }
    let differs = seen.iter().zip(&wanted).position(|(seen, wanted)| seen != wanted);
    assert_eq!((differs, seen.len()), (None, wanted.len()));
}

#[test]
fn seek_shows_the_state_there_and_playback_continues() {
    let (playback, _) = play("sought", true);
    let mut viewer = Viewer::ready(playback.address(), "/state");
    viewer.subscribe(&["/state", "/scene", "/log"]);
    request(&mut viewer, PAUSE, 1.0, Some(2.0));
    let (_, (time, _, has_sought)) = until(&mut viewer, PAUSED);
    assert_eq!((time, has_sought), (ns(2.0), true));
    // The vehicle's shape, earlier events, the trail and the plan, although nothing plays.
    let mut missing = vec!["base_link_ref", "trail", "plan", "armed"];
    while !missing.is_empty() {
        let data = viewer.data();
        assert!(data.topic != "/state", "it stands still");
        missing.retain(|text| !data.body.windows(text.len()).any(|part| part == text.as_bytes()));
    }
    request(&mut viewer, PLAY, 1.0, None);
    let first = std::iter::repeat_with(|| viewer.data()).find(|data| data.topic == "/state");
    assert_eq!(first.expect("a state").time, ns(2.01));
    // Back to the beginning.
    request(&mut viewer, PLAY, 1.0, Some(0.0));
    let first = std::iter::repeat_with(|| viewer.data())
        .find(|data| data.topic == "/state" && data.time < ns(1.0));
    assert!(first.expect("a state").time < ns(0.1));
}

#[test]
fn paused_log_stands_still_and_exposes_its_facts() {
    let (playback, _) = play("paused", false);
    let mut viewer = Viewer::ready(playback.address(), "/state");
    viewer.subscribe(&["/state"]);
    request(&mut viewer, PAUSE, 1.0, None);
    let (_, (time, ..)) = until(&mut viewer, PAUSED);
    // Times published from then on are the same.
    let mut received = 0;
    while received < 3 {
        if let ServerMessage::Time(now) = viewer.receive() {
            received += usize::from(now == time);
            assert!(now <= time);
        }
    }
    viewer.send(json!({"op": "getParameters", "id": "p", "parameterNames": ["vehicle"]}));
    loop {
        if let ServerMessage::Json(answer) = viewer.receive() {
            assert_eq!(answer["parameters"][0]["value"], "crazyflie 2");
            break;
        }
    }
    request(&mut viewer, PLAY, 2.0, None);
    let (_, (_, speed, _)) = until(&mut viewer, PLAYING);
    assert_eq!(speed, 2.0);
}

#[test]
fn empty_log_has_no_span() {
    let folder = std::env::temp_dir().join(format!("downwash-empty-{}", std::process::id()));
    let log = write(&folder, &[]);
    let recording = Recording::read(LogReader::open(&log).expect("a log")).expect("readable");
    std::fs::remove_dir_all(&folder).expect("removed");
    assert_eq!(recording.span(), None);
}
