//! Transports over the real loopback interface and a real pseudo-terminal.

use std::future::Future;
use std::io;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio_serial::{SerialPort, SerialStream};
use wire::Endpoint;
use wire::transport::{Incoming, PEERS_MAX, Peer, RECEIVE_LEN, Transport};

/// Bounds every wait; a test takes this long only if it hangs.
async fn soon<F: Future>(future: F) -> F::Output {
    tokio::time::timeout(Duration::from_secs(20), future).await.expect("the system answers")
}

async fn open(text: &str) -> Transport {
    let endpoint: Endpoint = text.parse().expect("valid endpoint");
    soon(Transport::open(&endpoint)).await.expect("endpoint opens")
}

fn port(transport: &Transport) -> u16 {
    transport.local_addr().expect("has an address").port()
}

/// Receives bytes and skips opened connections.
async fn receive(transport: &mut Transport) -> (Peer, Vec<u8>) {
    let mut buffer = vec![0; RECEIVE_LEN];
    loop {
        match soon(transport.recv(&mut buffer)).await.expect("transport lives") {
            Incoming::Bytes { peer, len } => return (peer, buffer[..len].to_vec()),
            Incoming::Opened(_) => {}
            Incoming::Closed(peer) => panic!("{peer:?} closed"),
        }
    }
}

#[tokio::test]
async fn udpin_answers_each_sender_at_its_address() {
    let mut listener = open("udpin:127.0.0.1:0").await;
    assert!(listener.is_datagram());
    let mut a = open(&format!("udpout:127.0.0.1:{}", port(&listener))).await;
    let mut b = open(&format!("udpout:127.0.0.1:{}", port(&listener))).await;
    let remote = a.peers().next().expect("udpout has its peer at once");

    assert!(a.send(remote, b"from a"));
    let (peer_a, bytes) = receive(&mut listener).await;
    assert_eq!(bytes, b"from a");
    assert!(b.send(remote, b"from b"));
    let (peer_b, bytes) = receive(&mut listener).await;
    assert_eq!(bytes, b"from b");
    assert_ne!(peer_a, peer_b);

    assert!(listener.send(peer_a, b"to a"));
    assert!(listener.send(peer_b, b"to b"));
    assert_eq!(receive(&mut a).await.1, b"to a");
    assert_eq!(receive(&mut b).await.1, b"to b");

    listener.close(peer_a);
    assert!(!listener.send(peer_a, b"gone"));
    assert_eq!(listener.stats().dropped, 1);
}

#[tokio::test]
async fn blocking_wait_receives_datagrams_in_order() {
    let mut listener = open("udpin:127.0.0.1:0").await;
    let mut vehicle = open(&format!("udpout:127.0.0.1:{}", port(&listener))).await;
    let remote = vehicle.peers().next().expect("udpout has its peer at once");
    let mut buffer = vec![0; RECEIVE_LEN];
    assert_eq!(listener.wait(&mut buffer, Duration::ZERO).unwrap(), None);
    assert!(vehicle.send(remote, b"one") && vehicle.send(remote, b"two"));
    let one = listener.wait(&mut buffer, Duration::from_secs(20)).unwrap();
    assert!(matches!(one, Some(Incoming::Bytes { len: 3, .. })) && buffer.starts_with(b"one"));
    // Receiving through the runtime continues where the blocking wait stopped, and vice versa.
    let (peer, bytes) = receive(&mut listener).await;
    assert_eq!(bytes, b"two");
    assert!(listener.send(peer, b"answer"));
    let answer = vehicle.wait(&mut buffer, Duration::from_secs(20)).unwrap();
    assert_eq!(answer, Some(Incoming::Bytes { peer: remote, len: 6 }));
}

#[tokio::test]
async fn blocking_wait_on_a_stream_is_unsupported() {
    let mut listener = open("tcpin:127.0.0.1:0").await;
    let error = listener.wait(&mut [0; 8], Duration::ZERO).expect_err("refused");
    assert_eq!(error.kind(), io::ErrorKind::Unsupported);
}

#[tokio::test]
async fn udpin_keeps_its_peer_among_a_thousand_strangers() {
    let mut listener = open("udpin:127.0.0.1:0").await;
    let to = ("127.0.0.1", port(&listener));
    let vehicle = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    vehicle.send_to(b"v", to).await.unwrap();
    let (vehicle_peer, _) = receive(&mut listener).await;
    listener.keep(Some(vehicle_peer));
    let mut buffer = [0; 16];
    // Each of them is new, and the vehicle is silent in between.
    for _ in 0..1000 {
        let stray = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        stray.send_to(b"s", to).await.unwrap();
        while let Incoming::Closed(peer) = soon(listener.recv(&mut buffer)).await.unwrap() {
            assert_ne!(peer, vehicle_peer);
        }
    }
    assert!(listener.peers().count() <= PEERS_MAX);
    assert!(listener.send(vehicle_peer, b"still here"));
}

#[tokio::test]
async fn udpin_keeps_active_peers_when_its_table_is_full() {
    let mut listener = open("udpin:127.0.0.1:0").await;
    let to = ("127.0.0.1", port(&listener));
    let vehicle = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    vehicle.send_to(b"v", to).await.unwrap();
    let (vehicle_peer, _) = receive(&mut listener).await;
    let mut closed = Vec::new();
    for _ in 0..2 * PEERS_MAX {
        let stray = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        stray.send_to(b"s", to).await.unwrap();
        vehicle.send_to(b"v", to).await.unwrap();
        let mut buffer = [0; 16];
        for _ in 0..2 {
            while let Incoming::Closed(peer) = soon(listener.recv(&mut buffer)).await.unwrap() {
                closed.push(peer);
            }
        }
    }
    assert!(listener.peers().count() <= PEERS_MAX);
    assert!(listener.send(vehicle_peer, b"still here"));
    assert!(!closed.contains(&vehicle_peer));
    assert!(!closed.is_empty());
}

#[tokio::test]
async fn udpout_survives_a_remote_that_does_not_listen_yet() {
    let probe = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let address = probe.local_addr().unwrap();
    drop(probe);
    let mut transport = open(&format!("udpout:{address}")).await;
    let remote = transport.peers().next().unwrap();
    let mut buffer = [0; 64];
    transport.send(remote, b"anyone?");
    transport.send(remote, b"anyone?");
    let nothing = tokio::time::timeout(Duration::ZERO, transport.recv(&mut buffer)).await;
    assert!(nothing.is_err(), "a refusal is not an error");
    assert!(transport.stats().refused > 0);

    let late = UdpSocket::bind(address).await.unwrap();
    assert!(transport.send(remote, b"hello"));
    let (len, from) = soon(late.recv_from(&mut buffer)).await.unwrap();
    assert_eq!(&buffer[..len], b"hello");
    late.send_to(b"hi", from).await.unwrap();
    assert_eq!(receive(&mut transport).await.1, b"hi");
}

#[tokio::test]
async fn busy_port_is_named() {
    let first = open("udpin:127.0.0.1:0").await;
    let endpoint: Endpoint = format!("udpin:127.0.0.1:{}", port(&first)).parse().unwrap();
    let error = Transport::open(&endpoint).await.expect_err("port is taken");
    assert_eq!(error.kind(), io::ErrorKind::AddrInUse);
    assert!(error.to_string().contains("in use"), "{error}");
    assert!(error.to_string().contains(&endpoint.to_string()), "{error}");
}

#[tokio::test]
async fn tcpin_serves_several_peers_and_reports_who_left() {
    let mut listener = open("tcpin:127.0.0.1:0").await;
    assert!(!listener.is_datagram());
    let mut a = open(&format!("tcp:127.0.0.1:{}", port(&listener))).await;
    let mut b = TcpStream::connect(("127.0.0.1", port(&listener))).await.unwrap();
    b.write_all(b"from b").await.unwrap();
    let (peer_b, bytes) = receive(&mut listener).await;
    assert_eq!(bytes, b"from b");
    let remote = a.peers().next().unwrap();
    a.send(remote, b"from a");
    let (peer_a, bytes) = receive(&mut listener).await;
    assert_eq!(bytes, b"from a");

    assert!(listener.send(peer_a, b"to a"));
    assert_eq!(receive(&mut a).await.1, b"to a");
    drop(b);
    let mut buffer = [0; 64];
    let event = soon(listener.recv(&mut buffer)).await.unwrap();
    assert_eq!(event, Incoming::Closed(peer_b));
    assert!(!listener.send(peer_b, b"gone"));
    assert_eq!(listener.peers().collect::<Vec<_>>(), [peer_a]);

    drop(listener);
    let error = soon(a.recv(&mut buffer)).await.expect_err("far end closed");
    assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
}

#[tokio::test]
async fn tcpin_refuses_peers_beyond_its_limit() {
    let mut listener = open("tcpin:127.0.0.1:0").await;
    let mut clients = Vec::new();
    let mut buffer = [0; 64];
    for _ in 0..PEERS_MAX {
        clients.push(TcpStream::connect(("127.0.0.1", port(&listener))).await.unwrap());
        assert!(matches!(soon(listener.recv(&mut buffer)).await, Ok(Incoming::Opened(_))));
    }
    let mut extra = TcpStream::connect(("127.0.0.1", port(&listener))).await.unwrap();
    clients[0].write_all(b"x").await.unwrap();
    assert!(matches!(soon(listener.recv(&mut buffer)).await, Ok(Incoming::Bytes { .. })));
    assert_eq!(listener.stats().turned_away, 1);
    assert_eq!(soon(extra.read(&mut buffer)).await.unwrap(), 0);
}

#[tokio::test]
async fn full_stream_drops_only_whole_frames() {
    const FRAME: usize = 100_000;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut sender = open(&format!("tcp:{}", listener.local_addr().unwrap())).await;
    let (mut far, _) = listener.accept().await.unwrap();
    let remote = sender.peers().next().unwrap();
    let (mut taken, mut number) = (Vec::new(), 0u32);
    while sender.stats().dropped < 3 {
        let frame = number.to_be_bytes().repeat(FRAME / 4);
        // Readiness is registered by receiving, as in the daemon's loop.
        let mut buffer = [0; 16];
        let _ = tokio::time::timeout(Duration::ZERO, sender.recv(&mut buffer)).await;
        if sender.send(remote, &frame) {
            taken.push(frame);
        }
        number += 1;
    }
    let expected = taken.concat();
    let reader = async {
        let mut received = vec![0; expected.len()];
        far.read_exact(&mut received).await.unwrap();
        received
    };
    let mut buffer = [0; 16];
    let received = soon(async {
        tokio::select! {
            received = reader => received,
            incoming = sender.recv(&mut buffer) => panic!("nothing was sent back: {incoming:?}"),
        }
    })
    .await;
    assert!(received == expected, "what was accepted arrives complete and in order");
}

#[tokio::test]
async fn dropped_receive_loses_nothing() {
    let mut listener = open("tcpin:127.0.0.1:0").await;
    let mut client = TcpStream::connect(("127.0.0.1", port(&listener))).await.unwrap();
    let mut received = Vec::new();
    let mut buffer = [0; 7];
    for byte in 0..=255u8 {
        client.write_all(&[byte]).await.unwrap();
        let waited = tokio::time::timeout(Duration::ZERO, listener.recv(&mut buffer)).await;
        if let Ok(Ok(Incoming::Bytes { len, .. })) = waited {
            received.extend_from_slice(&buffer[..len]);
        }
    }
    while received.len() < 256 {
        received.extend(receive(&mut listener).await.1);
    }
    assert_eq!(received, (0..=255).collect::<Vec<u8>>());
}

#[tokio::test]
async fn serial_port_is_exclusive_and_reports_unplugging() {
    let (mut device, slave) = SerialStream::pair().unwrap();
    let path = slave.name().expect("a pty has a path");
    drop(slave);
    let endpoint: Endpoint = format!("serial:{path}:921600").parse().unwrap();
    let mut transport = Transport::open(&endpoint).await.unwrap();
    let error = Transport::open(&endpoint).await.expect_err("exclusive");
    assert_eq!(error.kind(), io::ErrorKind::ResourceBusy, "{error}");
    assert!(error.to_string().contains("in use"), "{error}");
    assert!(!transport.is_datagram());
    let remote = transport.peers().next().unwrap();

    device.write_all(&[0, 0xFD, 0x0A, 0x11, 0xFF]).await.unwrap();
    let mut bytes = Vec::new();
    while bytes.len() < 5 {
        bytes.extend(receive(&mut transport).await.1);
    }
    assert_eq!(bytes, [0, 0xFD, 0x0A, 0x11, 0xFF], "raw mode: the terminal interprets no byte");
    assert!(transport.send(remote, b"\xFE\n\r"));
    let mut buffer = [0; 64];
    let len = soon(device.read(&mut buffer)).await.unwrap();
    assert_eq!(&buffer[..len], b"\xFE\n\r");

    drop(device);
    soon(transport.recv(&mut buffer)).await.expect_err("pulled");
    soon(transport.recv(&mut buffer)).await.expect_err("still pulled: an error, never a spin");
}

#[tokio::test]
async fn serial_errors_say_what_to_do() {
    let endpoint: Endpoint = "serial:/dev/no-such-port:57600".parse().unwrap();
    let error = Transport::open(&endpoint).await.expect_err("no device");
    assert_eq!(error.kind(), io::ErrorKind::NotFound);
    assert!(error.to_string().contains("plugged in"), "{error}");
}
