//! A client of the live view that receives all topics as they come.

use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::Message;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;

use crate::processes::{Process, unpin};

/// What a viewer does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manner {
    /// It takes what comes.
    Takes,
    /// It reads nothing of what it asked for.
    Stalls,
    /// It takes what comes, and sets the feedback's factor all the time.
    Sets,
}

/// Between two settings.
const SET_PERIOD: Duration = Duration::from_millis(50);

/// A viewer on a separate thread.
pub struct Viewer(Arc<AtomicU64>);

impl Viewer {
    /// Number of topic messages so far.
    pub fn messages(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Subscribes to every topic of the daemon's view.
pub fn watch(daemon: &Process, manner: Manner) -> Viewer {
    let words = daemon.log.as_ref().and_then(|log| std::fs::read_to_string(log).ok());
    let words = words.unwrap_or_default();
    let address = words.split("http://").nth(1).and_then(|rest| rest.split('/').next());
    let address = address.expect("the daemon says where its view is").to_owned();
    let stream = TcpStream::connect(&address).expect("the view listens");
    let mut request = format!("ws://{address}/").into_client_request().expect("an address");
    let protocol = HeaderValue::from_static("foxglove.sdk.v1");
    request.headers_mut().insert("sec-websocket-protocol", protocol);
    let (mut socket, _) = tungstenite::client(request, stream).expect("a handshake");
    let count = Arc::new(AtomicU64::new(0));
    let counter = Arc::clone(&count);
    std::thread::spawn(move || {
        unpin();
        let (mut set, mut factor) = (Instant::now(), 1.0);
        while let Ok(message) = socket.read() {
            if manner == Manner::Sets && set.elapsed() >= SET_PERIOD {
                (set, factor) = (Instant::now(), 2.1 - factor);
                let name = "flight.feedback_scale";
                let asked = json!([{"name": name, "value": factor, "type": "float64"}]);
                let asked = json!({"op": "setParameters", "id": "set", "parameters": asked});
                socket.send(Message::text(asked.to_string())).expect("set");
            }
            match message {
                Message::Text(text) => {
                    let value: Value = serde_json::from_str(&text).expect("JSON");
                    let topics = value["channels"].as_array().into_iter().flatten();
                    let asked: Vec<_> = topics
                        .map(|topic| json!({"id": topic["id"], "channelId": topic["id"]}))
                        .collect();
                    if !asked.is_empty() {
                        let asked = json!({"op": "subscribe", "subscriptions": asked});
                        socket.send(Message::text(asked.to_string())).expect("subscribed");
                        if manner == Manner::Stalls {
                            // `park` may return without a wake-up.
                            loop {
                                std::thread::park();
                            }
                        }
                    }
                }
                Message::Binary(bytes) if bytes.first() == Some(&1) => {
                    counter.fetch_add(1, Ordering::Relaxed);
                }
                _ => {}
            }
        }
    });
    Viewer(count)
}
