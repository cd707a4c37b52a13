//! A viewer: a client of Foxglove's WebSocket protocol, written from its specification.

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

/// Bounds every wait; a test takes this long only if it hangs.
const LIMIT: Duration = Duration::from_secs(20);

/// One message of a topic.
#[derive(Clone, Debug, PartialEq)]
pub struct Data {
    pub topic: String,
    /// ns
    pub time: u64,
    pub body: Vec<u8>,
}

/// A message from the server.
#[derive(Clone, Debug, PartialEq)]
pub enum ServerMessage {
    Json(Value),
    Data(Data),
    /// ns
    Time(u64),
    /// Status, time in ns, speed, whether it answers a seek.
    Playback(u8, u64, f32, bool),
}

pub struct Viewer {
    socket: WebSocket<TcpStream>,
    /// Channel ids of the topics.
    pub topics: BTreeMap<String, u64>,
    subscribed: BTreeMap<u32, String>,
}

impl Viewer {
    pub fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).expect("the view listens");
        stream.set_read_timeout(Some(LIMIT)).expect("a limit");
        let mut request = format!("ws://{address}/").into_client_request().expect("an address");
        let protocol = HeaderValue::from_static("foxglove.sdk.v1");
        request.headers_mut().insert("sec-websocket-protocol", protocol);
        let (socket, _) = tungstenite::client(request, stream).expect("a handshake");
        Self { socket, topics: BTreeMap::new(), subscribed: BTreeMap::new() }
    }

    /// Connects and waits until the server has advertised `topic`.
    pub fn ready(address: SocketAddr, topic: &str) -> Self {
        let mut viewer = Self::connect(address);
        while !viewer.topics.contains_key(topic) {
            viewer.receive();
        }
        viewer
    }

    /// Shrinks the receive buffer, so that unread data fill it soon.
    pub fn keep_little(&self) {
        use std::os::fd::AsRawFd;
        let (fd, size) = (self.socket.get_ref().as_raw_fd(), 16_384_i32);
        // SAFETY: the option's value is an integer of this size.
        let set = unsafe {
            let value = (&raw const size).cast();
            libc::setsockopt(fd, libc::SOL_SOCKET, libc::SO_RCVBUF, value, 4)
        };
        assert_eq!(set, 0);
    }

    pub fn send(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).expect("sent");
    }

    pub fn send_bytes(&mut self, bytes: Vec<u8>) -> Result<(), tungstenite::Error> {
        self.socket.send(Message::binary(bytes))
    }

    pub fn subscribe(&mut self, topics: &[&str]) {
        let mut asked = Vec::new();
        for topic in topics {
            let id = self.subscribed.len() as u32 + 100;
            self.subscribed.insert(id, (*topic).to_owned());
            asked.push(json!({"id": id, "channelId": self.topics[*topic]}));
        }
        self.send(json!({"op": "subscribe", "subscriptions": asked}));
        // The server answers in order, so what follows is answered after this.
        self.send(json!({"op": "getParameters", "id": "subscribed", "parameterNames": ["none"]}));
        while !matches!(self.receive(), ServerMessage::Json(answer) if answer["id"] == "subscribed")
        {
        }
    }

    pub fn receive(&mut self) -> ServerMessage {
        self.try_receive().expect("the server speaks")
    }

    pub fn try_receive(&mut self) -> Result<ServerMessage, tungstenite::Error> {
        loop {
            match self.socket.read()? {
                Message::Text(text) => {
                    let value: Value = serde_json::from_str(&text).expect("JSON");
                    for channel in value["channels"].as_array().into_iter().flatten() {
                        let topic = channel["topic"].as_str().expect("a topic").to_owned();
                        self.topics.insert(topic, channel["id"].as_u64().expect("a number"));
                    }
                    return Ok(ServerMessage::Json(value));
                }
                Message::Binary(bytes) => return Ok(self.decode(&bytes)),
                _ => {}
            }
        }
    }

    fn decode(&self, bytes: &[u8]) -> ServerMessage {
        let u64_at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("8"));
        match bytes[0] {
            1 => {
                let id = u32::from_le_bytes(bytes[1..5].try_into().expect("4"));
                let topic = self.subscribed[&id].clone();
                ServerMessage::Data(Data { topic, time: u64_at(5), body: bytes[13..].to_vec() })
            }
            2 => ServerMessage::Time(u64_at(1)),
            5 => {
                let speed = f32::from_le_bytes(bytes[10..14].try_into().expect("4"));
                ServerMessage::Playback(bytes[1], u64_at(2), speed, bytes[14] != 0)
            }
            other => panic!("unknown message {other}"),
        }
    }

    /// The next message of a topic.
    pub fn data(&mut self) -> Data {
        loop {
            if let ServerMessage::Data(data) = self.receive() {
                return data;
            }
        }
    }
}
