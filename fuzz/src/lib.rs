//! What the fuzz targets do with their bytes. The root package's tests run the same functions on
//! random bytes, so that they are exercised without a fuzzer too.

use std::io;
use std::time::Duration;

use downwash::audit::Audit;
use downwash::clock::HostTime;
use downwash::control::Limits;
use downwash::guard::{Answered, Cleared, Guard, Obeys, Order, Proposal, Stance};
use downwash::link::attitude_target::ThrustMap;
use downwash::link::request::{FlightMode, Request};
use downwash::link::session::{Delivery, Session, Settings};
use downwash::link::tee::Tee;
use downwash::log::LogReader;
use downwash::log::export::{Format, export_topic};
use downwash::log::import::mapping::{Mapping, SHIPPED};
use downwash::log::import::{Flight, Stream, propose_bytes, read_bytes};
use downwash::log::info::LogInfo;
use downwash::mocap::bridge::Bridge;
use downwash::mocap::natnet::{self, Packet, Version};
use downwash::mocap::settings::MocapSettings;
use downwash::mocap::stream;
use downwash::parameters::ParameterFile;
use downwash::report::FlightReport;
use downwash::setpoint::Setpoint;
use downwash::vehicle_init::{Draft, Measured};
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::plant::{Plant, Setup};
use wire::Endpoint;
use wire::tlog::Reader;
use wire::transport::Peer;

/// What a target does with its bytes.
pub type Target = fn(&[u8]);

macro_rules! targets {
    ($($name:ident),*) => {
        /// Every target by its name, which is that of its file in `fuzz_targets` and of its folder
        /// in `corpus`.
        pub const TARGETS: &[(&str, Target)] = &[$((stringify!($name), $name)),*];
    };
}

targets![endpoint, flight_log, import, law, link, mocap, onboard, parameters, table, tlog];

/// A setpoint that may leave.
fn cleared(now: HostTime) -> Cleared {
    let mut guard = Guard::new(Limits::default(), 20.0, now);
    let setpoint = Setpoint { thrust_n: 9.81, ..Setpoint::default() };
    let sample = Answered { host: now, ..Answered::default() };
    let order = Order { stance: Stance::Offer, obeys: Obeys::No };
    guard.propose(now, &Proposal { setpoint, sample }, order).expect("permitted");
    guard.clear(now, order).expect("permitted")
}

/// A session that hears anything, in any chunks, from several peers, as time goes by.
pub fn link(data: &[u8]) {
    let thrust = ThrustMap::linear(20.0).expect("a positive thrust");
    let mut now = HostTime::from_ns(1_700_000_000_000_000_000);
    let mut session = Session::new(Settings::new(thrust), now);
    session.request(now, Request::SetMode(FlightMode::Offboard));
    session.request(now, Request::SetParameter { name: "COM_OF_LOSS_T".to_owned(), value: 0.2 });
    let mut tee = Tee::new(Vec::new());
    let mut rest = data;
    let mut total = 0;
    while let [control, len, bytes @ ..] = rest {
        let (chunk, tail) = bytes.split_at(bytes.len().min(usize::from(*len)));
        rest = tail;
        total += chunk.len() as u64;
        let peer = Peer::new(u32::from(control & 3));
        let is_datagram = control & 4 != 0;
        session.receive(now, peer, chunk, is_datagram, &mut |delivery| {
            if let Delivery::Message(received) = delivery {
                assert!(received.host == now);
            }
        });
        tee.received(now, peer, chunk, is_datagram).expect("memory takes everything");
        if control & 8 != 0 {
            session.peer_closed(peer);
            tee.peer_closed(now, peer).expect("memory takes everything");
        }
        // From nothing to 8 s: past every time-out.
        now = now + Duration::from_millis(u64::from(control >> 4).pow(3) * 2);
        session.poll(now);
        assert!(session.next_deadline() > now, "a poll does all that is due");
        // May be refused; must not panic.
        let _ = session.send_setpoint(now, &cleared(now));
        session.transmit(|_, frame| {
            assert!(!frame.is_empty());
            true
        });
        while session.next_event().is_some() {}
    }
    assert_eq!(session.stats().received.bytes, total);
    tee.finish(now).expect("memory takes everything");
    tlog(&tee.into_inner());
}

/// A telemetry log of anything: every byte is in an entry or skipped.
pub fn tlog(data: &[u8]) {
    let mut reader = Reader::new(data);
    let mut kept = 0;
    while let Some(entry) = reader.read().expect("memory gives everything") {
        kept += entry.frame.len() + if entry.time_us.is_some() { 8 } else { 0 };
    }
    assert_eq!(kept as u64 + reader.skipped_bytes(), data.len() as u64);
}

/// A flight log of anything, with and without the start of one: what can be read is summed up,
/// drawn and exported.
pub fn flight_log(data: &[u8]) {
    /// Topics that are exported: the cost of more is not worth their variety.
    const TOPICS: usize = 4;
    let started = [b"\x89MCAP0\r\n", data].concat();
    for bytes in [data, &started] {
        let Ok(mut reader) = LogReader::new(bytes) else { continue };
        let report = FlightReport::read(&mut reader).expect("memory gives everything");
        assert!(report.to_html().ends_with("</html>\n"));
        let reread = || LogReader::new(bytes).expect("it was read before");
        let info = LogInfo::read(&mut reread()).expect("memory gives everything");
        for topic in info.topics.iter().take(TOPICS) {
            for format in [Format::Csv, Format::JsonLines] {
                // Topics of other types than the project's are refused.
                let _ = export_topic(&mut reread(), &topic.topic, format, &mut io::sink());
            }
        }
    }
}

/// A flight of anything: its times ascend, and it can be audited.
fn check_flight(flight: &Flight) {
    fn check<T>(stream: &Stream<T>) {
        assert!(stream.times().iter().all(|time| time.is_finite()));
        assert!(stream.times().windows(2).all(|pair| pair[0] < pair[1]));
    }
    check(&flight.attitude);
    check(&flight.position);
    check(&flight.velocity);
    check(&flight.body_rate);
    check(&flight.specific_force);
    check(&flight.outputs);
    check(&flight.rotor_speed);
    check(&flight.setpoint);
    check(&flight.voltage);
    check(&flight.in_air);
    check(&flight.truth);
    for rows in flight.rows.iter() {
        assert!(rows.windows(2).all(|pair| pair[0] < pair[1]));
    }
}

/// A log of any kind to import, and the mapping of a table.
pub fn import(data: &[u8]) {
    const MAPPING: &str = include_str!("../../config/mappings/motion-capture.toml");
    let text = String::from_utf8_lossy(data);
    read_bytes(data, MAPPING).iter().chain(&read_bytes(data, &text)).for_each(check_flight);
}

/// A table of anything, read by the mappings that are shipped and by the one that is proposed for it,
/// which must be a mapping.
pub fn table(data: &[u8]) {
    for (_, mapping) in SHIPPED {
        read_bytes(data, mapping).iter().for_each(check_flight);
    }
    if let Some(mapping) = propose_bytes(data) {
        assert!(Mapping::parse(&mapping).is_ok(), "{mapping}");
        read_bytes(data, &mapping).iter().for_each(check_flight);
    }
}

/// What follows the first bytes of a PX4 or an ArduPilot log: a message definition or two, then
/// anything. What can be read is audited too.
pub fn onboard(data: &[u8]) {
    const ULOG: &[u8] = b"ULog\x01\x12\x35\x01\0\0\0\0\0\0\0\0\x2F\0Fvehicle_attitude:\
        uint64_t timestamp;float[4] q;\x13\0A\0\0\0vehicle_attitude";
    // FMT for itself, then for ATT with its stamp, roll, pitch and yaw.
    let definition = |kind: u8, length: u8, texts: [&str; 3]| {
        let mut bytes = vec![0xA3, 0x95, 128, kind, length];
        for (text, size) in texts.into_iter().zip([4, 16, 64]) {
            bytes.extend(text.bytes().chain(std::iter::repeat(0)).take(size));
        }
        bytes
    };
    let itself = definition(128, 89, ["FMT", "BBnNZ", "Type,Length,Name,Format,Columns"]);
    let attitude = definition(1, 17, ["ATT", "Qccc", "TimeUS,Roll,Pitch,Yaw"]);
    for log in [[ULOG, data].concat(), [&itself, &attitude, data].concat()] {
        import(&log);
        for flight in read_bytes(&log, "") {
            let audit = Audit::of(&flight);
            assert!(audit.findings.iter().all(|finding| !finding.to_string().is_empty()));
        }
    }
}

/// A connection string of anything: what is accepted is written and read back the same.
pub fn endpoint(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(endpoint) = text.parse::<Endpoint>() {
        assert_eq!(endpoint.to_string().parse(), Ok(endpoint));
    }
}

/// A law: as one line, and as a file, which is written and read back the same, and does what is finite.
pub fn law(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let mut set = EffectSet::new();
    let _ = set.insert_argument(text);
    if let Ok(read) = toml::from_str::<EffectSet>(text) {
        set = set.overlay(&read);
    }
    let written = serde_json::to_string(&set).expect("an effect set is JSON");
    assert_eq!(serde_json::from_str::<EffectSet>(&written).expect("it is read back"), set);
    let vehicle = VehicleParams::load("crazyflie").expect("a built-in vehicle");
    let laws = set.laws().iter().cloned();
    let mut alone = EffectSet::new();
    laws.for_each(|law| alone.insert_law(law).expect("no more than there were"));
    let mut plant =
        Plant::new(&vehicle, &alone, &Setup::default(), 1).expect("it flies").airborne();
    (0..50).for_each(|_| plant.step([0.6; 4]));
    assert!(plant.state().is_finite(), "{text}");
}

/// A parameter file, and the vehicle file that is made of it, which must be TOML.
pub fn parameters(data: &[u8]) {
    let Ok(file) = ParameterFile::parse(data) else { return };
    let Ok(found) = file.vehicle(None) else { return };
    let measured = Measured { mass_kg: Some(1.0), arm_m: Some(0.2), ..Measured::default() };
    let Ok(draft) = Draft::new("a file", &found.parameters, &measured) else { return };
    let text = draft.to_toml();
    assert!(toml::from_str::<toml::Table>(&text).is_ok(), "{text}");
}

/// Datagrams of a motion-capture room, as lines and as NatNet of every layout. The last byte of each
/// is the time that passes before it, ms. What is forwarded is finite.
pub fn mocap(data: &[u8]) {
    let start = HostTime::from_ns(1_700_000_000_000_000_000);
    let mut bridge = Bridge::new("1".to_owned(), MocapSettings::default(), start);
    let mut decoders = [(3, 0), (4, 0), (4, 1)]
        .map(|(major, minor)| natnet::Decoder::new(Version { major, minor }));
    let mut now = start;
    for datagram in data.chunks(512).chain([data]) {
        now = now + Duration::from_millis(datagram.last().map_or(1, |byte| u64::from(*byte)));
        let mut samples = Vec::new();
        stream::decode(datagram, |line| samples.extend(line.ok()));
        for decoder in &mut decoders {
            for message in [1u16, 7] {
                let length = datagram.len().min(usize::from(u16::MAX));
                let head = [message.to_le_bytes(), (length as u16).to_le_bytes()].concat();
                if let Ok(Packet::Frame(found)) = decoder.datagram(&[&head, datagram].concat()) {
                    samples.extend(found);
                }
            }
        }
        for sample in &samples {
            if let Some(pose) = bridge.take(now, sample, false) {
                assert!(pose.position.is_finite() && pose.attitude.tilt().is_finite());
            }
        }
        bridge.tick(now);
        while bridge.next_news().is_some() {}
    }
}
