//! The link reopens a lost connection, over real sockets and a real pseudo-terminal.

use std::future::Future;
use std::path::Path;
use std::time::Duration;

use downwash::clock::HostTime;
use downwash::link::attitude_target::ThrustMap;
use downwash::link::connection::{Connection, Input};
use downwash::link::session::{Delivery, Session, Settings};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, UdpSocket};
use tokio_serial::{SerialPort, SerialStream};
use wire::dialect::*;
use wire::{Decoder, Encoder};

use crate::link_world::cleared;

/// Bounds every wait; a test takes this long only if it hangs.
async fn soon<F: Future>(future: F) -> F::Output {
    tokio::time::timeout(Duration::from_secs(20), future).await.expect("the system answers")
}

fn connection(endpoint: &str) -> Connection {
    Connection::new(endpoint.parse().expect("valid endpoint"))
}

/// The next input other than a failure to open, and the number of those before it.
async fn next(connection: &mut Connection, buffer: &mut [u8]) -> (Input, usize) {
    let mut failures = 0;
    loop {
        match soon(connection.recv(buffer)).await {
            Input::Failed { .. } => failures += 1,
            input => return (input, failures),
        }
    }
}

async fn expect_bytes(connection: &mut Connection, expected: &[u8]) {
    let mut received = Vec::new();
    let mut buffer = [0; 256];
    while received.len() < expected.len() {
        match next(connection, &mut buffer).await {
            (Input::Bytes { len, .. }, _) => received.extend_from_slice(&buffer[..len]),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(received, expected);
}

/// Plugs in a new device: a pseudo-terminal under the name of the link. Returns the other side.
fn plug(link: &Path) -> SerialStream {
    let (device, slave) = SerialStream::pair().expect("a pseudo-terminal");
    let path = slave.name().expect("has a path");
    std::os::unix::fs::symlink(path, link).expect("link is free");
    device
}

#[tokio::test]
async fn replugged_serial_port_is_reopened() {
    let directory = std::env::temp_dir().join(format!("downwash-pty-{}", std::process::id()));
    std::fs::create_dir_all(&directory).unwrap();
    let link = directory.join("ttyACM0");
    let _ = std::fs::remove_file(&link);
    let mut connection = connection(&format!("serial:{}:921600", link.display()));
    let mut buffer = [0; 256];

    let mut device = plug(&link);
    assert!(matches!(next(&mut connection, &mut buffer).await, (Input::Opened, 0)));
    device.write_all(b"before").await.unwrap();
    expect_bytes(&mut connection, b"before").await;

    drop(device);
    std::fs::remove_file(&link).unwrap();
    assert!(matches!(next(&mut connection, &mut buffer).await, (Input::Lost(_), _)));
    assert!(!connection.send(None, b"into the void"));
    let failed = soon(connection.recv(&mut buffer)).await;
    match failed {
        Input::Failed { error, .. } => {
            assert!(error.to_string().contains("plugged in"), "{error}");
        }
        other => panic!("{other:?}"),
    }

    let mut device = plug(&link);
    assert!(matches!(next(&mut connection, &mut buffer).await, (Input::Opened, _)));
    device.write_all(b"after").await.unwrap();
    expect_bytes(&mut connection, b"after").await;
    assert!(connection.send(None, b"answer"));
    let len = soon(device.read(&mut buffer)).await.unwrap();
    assert_eq!(&buffer[..len], b"answer");
    std::fs::remove_dir_all(&directory).unwrap();
}

#[tokio::test]
async fn dropped_tcp_connection_is_reopened() {
    let server = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = server.local_addr().unwrap();
    let mut connection = connection(&format!("tcp:{address}"));
    let mut buffer = [0; 256];
    for message in [b"one", b"two"] {
        assert!(matches!(next(&mut connection, &mut buffer).await, (Input::Opened, _)));
        let (mut stream, _) = soon(server.accept()).await.unwrap();
        stream.write_all(message).await.unwrap();
        expect_bytes(&mut connection, message).await;
        drop(stream);
        assert!(matches!(next(&mut connection, &mut buffer).await, (Input::Lost(_), _)));
    }
    drop(server);
    let refused = soon(connection.recv(&mut buffer)).await;
    match refused {
        Input::Failed { error, .. } => assert!(error.to_string().contains("listens"), "{error}"),
        other => panic!("{other:?}"),
    }
    let server = TcpListener::bind(address).await.unwrap();
    assert!(matches!(next(&mut connection, &mut buffer).await, (Input::Opened, _)));
    drop(server);
}

#[tokio::test]
async fn busy_port_is_opened_once_it_is_free() {
    let other = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let mut connection = connection(&format!("udpin:{}", other.local_addr().unwrap()));
    let mut buffer = [0; 256];
    match soon(connection.recv(&mut buffer)).await {
        Input::Failed { error, .. } => assert!(error.to_string().contains("in use"), "{error}"),
        other => panic!("{other:?}"),
    }
    drop(other);
    assert!(matches!(next(&mut connection, &mut buffer).await, (Input::Opened, _)));
    assert!(connection.is_open() && connection.is_datagram());
}

#[tokio::test]
async fn connection_attempt_survives_a_dropped_future() {
    let server = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut connection = connection(&format!("tcp:{}", server.local_addr().unwrap()));
    let mut buffer = [0; 256];
    // As in a control loop whose deadlines interrupt the wait.
    let opened = soon(async {
        loop {
            let wait = tokio::time::timeout(Duration::ZERO, connection.recv(&mut buffer));
            if let Ok(input) = wait.await {
                break input;
            }
        }
    })
    .await;
    assert!(matches!(opened, Input::Opened));
    soon(server.accept()).await.unwrap();
}

/// The messages of the next datagram at a vehicle's socket, and their sender.
async fn hear(vehicle: &UdpSocket) -> (Vec<MavMessage>, std::net::SocketAddr) {
    let mut buffer = [0; 512];
    let (len, from) = soon(vehicle.recv_from(&mut buffer)).await.unwrap();
    let mut decoder = Decoder::new();
    decoder.push(&buffer[..len]);
    let frames = std::iter::from_fn(|| decoder.next_frame());
    (frames.map(|frame| frame.message().unwrap()).collect(), from)
}

#[tokio::test]
async fn vehicle_over_udp_is_greeted_identified_and_sent_a_setpoint() {
    let vehicle = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let mut connection = connection(&format!("udpout:{}", vehicle.local_addr().unwrap()));
    let now = HostTime::from_ns(1_700_000_000_000_000_000);
    let mut session = Session::new(Settings::new(ThrustMap::linear(20.0).unwrap()), now);
    let mut buffer = [0; 512];
    assert!(matches!(next(&mut connection, &mut buffer).await, (Input::Opened, 0)));

    // The daemon sends first, because a listening vehicle knows no peer.
    session.poll(now);
    session.transmit(|to, frame| connection.send(to, frame));
    let (heard, daemon) = hear(&vehicle).await;
    assert!(matches!(heard[..], [MavMessage::HEARTBEAT(_)]));

    let mut encoder = Encoder::new(1, 1);
    let mut datagram = Vec::new();
    let heartbeat = HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
        ..Default::default()
    };
    encoder.encode(&MavMessage::HEARTBEAT(heartbeat), &mut datagram);
    encoder.encode(&MavMessage::AUTOPILOT_VERSION(Default::default()), &mut datagram);
    vehicle.send_to(&datagram, daemon).await.unwrap();
    let (Input::Bytes { peer, len }, _) = next(&mut connection, &mut buffer).await else {
        panic!("no bytes");
    };
    let mut messages = 0;
    session.receive(now, peer, &buffer[..len], connection.is_datagram(), &mut |delivery| {
        messages += usize::from(matches!(delivery, Delivery::Message(_)));
    });
    assert_eq!(messages, 2);
    session.transmit(|_, _| true);
    session.send_setpoint(now, &cleared(now, 10.0)).unwrap();
    session.transmit(|to, frame| connection.send(to, frame));
    assert_eq!(session.stats().dropped, 0);
    let (heard, _) = hear(&vehicle).await;
    let [MavMessage::SET_ATTITUDE_TARGET(target)] = &heard[..] else { panic!("{heard:?}") };
    assert_eq!((target.thrust, target.type_mask.bits()), (0.5, 0x07));
}
