//! The flight log: records round-trip, and a damaged file still yields its intact part.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::log_flight::{START, records, run_info, write};
use downwash::log::descriptor::Layout;
use downwash::log::export::{ExportError, Format, export_all, export_topic};
use downwash::log::info::LogInfo;
use downwash::log::reader::{LogReader, ReadError};
use downwash::log::record::{Record, Severity, Source, Stamp, Tick};
use downwash::log::schema::{BatteryMessage, ControlMessage, SetpointMessage, StateMessage};
use downwash::log::{LogSink, LogWriter};
use downwash::setpoint::{Setpoint, State};
use proptest::prelude::*;
use vehicle::frame::{Euler, Frd, Ned};

/// A fresh directory for the test `name`.
fn directory(name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log_file").join(name);
    let _ = fs::remove_dir_all(&directory);
    directory
}

/// Topic, times and body of every message.
type Bodies = Vec<(String, u64, u64, Vec<u8>)>;

fn bodies(bytes: &[u8]) -> (Bodies, LogReader<&[u8]>) {
    let mut reader = LogReader::new(bytes).expect("an MCAP file");
    let mut out = Vec::new();
    while let Some(m) = reader.next_message().expect("no i/o error in memory") {
        let topic = m.channel.topic.clone();
        out.push((topic, m.log_time.as_ns(), m.publish_time.as_ns(), m.data.to_vec()));
    }
    (out, reader)
}

fn write_synced(directory: &Path, records: &[Record], every: usize) -> PathBuf {
    let mut wall = Instant::now();
    let mut writer = LogWriter::create(directory, &run_info(), START, wall).expect("create");
    for (number, record) in records.iter().enumerate() {
        writer.write(record).expect("write");
        if number % every == 0 {
            wall += Duration::from_secs(1);
            writer.sync_if_due(wall).expect("sync");
        }
    }
    writer.finish().expect("finish").path
}

#[test]
fn finished_log_holds_everything_in_order() {
    let records = records(2.0);
    let path = write(&directory("finished"), &records);
    assert_eq!(path.file_name().unwrap(), "2026-01-01T00-00-00Z_crazyflie-2_sinusoid-yaw.mcap");
    let bytes = fs::read(&path).unwrap();
    let (messages, reader) = bodies(&bytes);
    assert!(reader.ending().finished && reader.ending().damaged == 0);
    assert_eq!(reader.run()["seed"], "7");
    assert_eq!(reader.run()["source"], "sim");
    assert_eq!(reader.attachments()[1].data, b"mass_kg = 0.034\n");
    let mut counts = BTreeMap::new();
    messages.iter().for_each(|(topic, ..)| *counts.entry(topic.as_str()).or_insert(0) += 1);
    assert_eq!(counts["/mavlink/rx"], 1600);
    assert_eq!(counts["/mavlink/tx"], 200);
    assert_eq!(counts["/state"], 200);
    assert_eq!(counts["/imu"], 500);
    assert_eq!(counts["/vehicle/pose"], 100);
    assert_eq!(counts["/scene"], 1);
    assert!(counts["/setpoint"] < 200, "the last ticks sent nothing");
    assert!(messages.windows(2).all(|w| w[0].1 <= w[1].1));
}

#[test]
fn sync_points_do_not_change_the_messages() {
    let records = records(1.0);
    let once = fs::read(write(&directory("once"), &records)).unwrap();
    let often = fs::read(write_synced(&directory("often"), &records, 50)).unwrap();
    assert_ne!(once, often, "chunk boundaries differ");
    assert_eq!(bodies(&once).0, bodies(&often).0);
}

#[test]
fn nan_stays_nan_and_unknown_becomes_nan() {
    let tick = records(0.1).into_iter().find_map(|r| match r {
        Record::Tick(tick) => Some(tick),
        _ => None,
    });
    let mut tick = tick.expect("a tick");
    tick.reference = None;
    tick.setpoint = None;
    tick.state.velocity = Ned::new(f64::NAN, 0.0, -0.0);
    let battery = Record::Battery {
        stamp: Stamp::host(START),
        voltage: Some(4.0),
        current: None,
        remaining: None,
    };
    let bytes = fs::read(write(&directory("nan"), &[Record::Tick(tick), battery])).unwrap();
    let mut reader = LogReader::new(&bytes[..]).unwrap();
    let mut seen = 0;
    while let Some(message) = reader.next_message().unwrap() {
        assert_ne!(message.channel.topic, "/setpoint");
        if let Some(state) = message.decode::<StateMessage>() {
            assert!(state.v_n_mps.is_nan() && state.v_e_mps == 0.0);
            seen += 1;
        }
        if let Some(control) = message.decode::<ControlMessage>() {
            assert!(control.error_3d_m.is_nan() && control.ff_thrust_n.is_nan());
            seen += 1;
        }
        if let Some(battery) = message.decode::<BatteryMessage>() {
            assert!(battery.voltage_v == 4.0 && battery.current_a.is_nan());
            seen += 1;
        }
    }
    assert_eq!(seen, 3);
}

#[test]
fn truncated_log_gives_every_whole_chunk() {
    let path = write_synced(&directory("cut"), &records(0.06), 30);
    let bytes = fs::read(path).unwrap();
    let (all, _) = bodies(&bytes);
    let mut most = 0;
    for cut in 0..bytes.len() {
        let (part, reader) = bodies(&bytes[..cut]);
        assert!(!reader.ending().finished, "cut at {cut}");
        assert_eq!(reader.ending().damaged, 0, "truncation is not damage, at {cut}");
        assert!(part.len() >= most, "a longer file never holds less, at {cut}");
        assert!(part.len() <= most + 200, "one chunk at a time, at {cut}");
        assert_eq!(part, all[..part.len()]);
        most = part.len();
    }
    assert_eq!(most, all.len(), "the summary holds no messages");
}

#[test]
fn damaged_chunk_is_skipped_and_reading_continues() {
    let path = write_synced(&directory("damaged"), &records(0.5), 100);
    let mut bytes = fs::read(path).unwrap();
    let (all, _) = bodies(&bytes);
    let middle = bytes.len() / 2;
    bytes[middle..middle + 8].iter_mut().for_each(|b| *b ^= 0xFF);
    let (part, reader) = bodies(&bytes);
    assert!(reader.ending().finished);
    assert_eq!(reader.ending().damaged, 1, "{:?}", reader.ending().damages);
    assert!(reader.ending().damages[0].starts_with("chunk at byte "));
    assert!(part.len() < all.len() && part.len() > all.len() / 2);
    assert_eq!(part.last(), all.last());
}

#[test]
fn non_mcap_files_are_refused() {
    let found = LogReader::new(&b"ULog\x01\x12\x35\x01 and more"[..]).err();
    assert!(matches!(found, Some(ReadError::NotMcap { .. })));
    let missing = LogReader::open(Path::new("no/such.mcap")).err().unwrap();
    assert!(missing.to_string().contains("no/such.mcap"));
}

#[test]
fn existing_log_is_never_overwritten() {
    let directory = directory("names");
    let first = write(&directory, &records(0.1));
    let second = write(&directory, &records(0.1));
    assert_ne!(first, second);
    assert!(second.to_str().unwrap().ends_with("_sinusoid-yaw-2.mcap"));
}

#[test]
fn facts_learned_later_add_to_the_run() {
    let facts = BTreeMap::from([("firmware".to_owned(), "1.15.4".to_owned())]);
    let path = write(&directory("facts"), &[Record::Facts(Box::new(facts))]);
    let mut reader = LogReader::open(&path).unwrap();
    assert!(reader.next_message().unwrap().is_none());
    assert_eq!(reader.run()["firmware"], "1.15.4");
    assert_eq!(reader.run()["vehicle"], "crazyflie 2");
}

#[test]
fn threaded_and_direct_sinks_write_the_same() {
    let records = records(1.0);
    let direct = fs::read(write(&directory("direct"), &records)).unwrap();
    let writer =
        LogWriter::create(&directory("threaded"), &run_info(), START, Instant::now()).unwrap();
    let mut sink = LogSink::threaded(writer, Vec::new()).unwrap();
    records.iter().for_each(|r| sink.log(r.clone()));
    let summary = sink.finish().unwrap().unwrap();
    assert_eq!(summary.dropped, 0);
    let threaded = fs::read(&summary.path).unwrap();
    assert_eq!(bodies(&direct).0, bodies(&threaded).0);
}

#[cfg(unix)]
#[test]
fn uncreatable_directory_is_named_in_the_error() {
    let directory = Path::new("/dev/null/logs");
    let error = LogWriter::create(directory, &run_info(), START, Instant::now()).err().unwrap();
    assert!(error.to_string().contains("/dev/null/logs"));
}

#[test]
fn info_summarises_the_flight() {
    let path = write(&directory("info"), &records(10.0));
    let info = LogInfo::read(&mut LogReader::open(&path).unwrap()).unwrap();
    assert!(info.finished);
    assert!((info.duration_s - 10.0).abs() < 0.02);
    let phases: Vec<_> = info.phases.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(phases, ["takeoff", "track", "land"]);
    assert!((info.phases[1].duration_s - 7.0).abs() < 0.05);
    let tracking = info.tracking.unwrap();
    assert_eq!(tracking.ticks, 700);
    assert!(tracking.rmse_3d_m > 0.001 && tracking.max_3d_m >= tracking.rmse_3d_m);
    let imu = info.topics.iter().find(|t| t.topic == "/imu").unwrap();
    assert!((imu.rate_hz.unwrap() - 250.0).abs() < 0.1 && imu.gaps == 0);
    let battery = info.battery.unwrap();
    assert_eq!(battery.voltage_max_v, Some(4.1));
    assert_eq!((battery.current_max_a, battery.remaining_ratio), (Some(6.0), None));
    assert_eq!(info.events_total, 3);
    assert_eq!((info.events[1].level, info.events[1].source.as_str()), ("warning", "vehicle"));
    let json = serde_json::to_value(&info.topics[0]).unwrap();
    assert!(json["messages"].is_u64());
}

#[test]
fn export_gives_csv_and_json_with_null_for_nan() {
    let path = write(&directory("export"), &records(1.0));
    let export = |topic: &str, format| {
        let mut out = Vec::new();
        let mut reader = LogReader::open(&path).unwrap();
        export_topic(&mut reader, topic, format, &mut out).map(|n| (n, out))
    };
    let (rows, csv) = export("/battery", Format::Csv).unwrap();
    let csv = String::from_utf8(csv).unwrap();
    let lines: Vec<_> = csv.lines().collect();
    assert_eq!(lines[0], "log_time_ns,publish_time_ns,voltage_v,current_a,remaining_ratio");
    assert!(lines[1].ends_with(",4.1,NaN,NaN"), "{}", lines[1]);
    assert_eq!(lines.len() as u64, rows + 1);
    let (_, jsonl) = export("/battery", Format::JsonLines).unwrap();
    let first = String::from_utf8(jsonl).unwrap().lines().next().unwrap().to_owned();
    let row: serde_json::Value = serde_json::from_str(&first).unwrap();
    assert!(row["current_a"].is_null() && row["voltage_v"] == 4.1);
    let (_, log) = export("/log", Format::Csv).unwrap();
    assert!(String::from_utf8(log).unwrap().contains("armed"));
    let error = export("/nothing", Format::Csv).unwrap_err();
    assert!(matches!(&error, ExportError::NoTopic { known, .. } if known.len() > 10));

    let mut reader = LogReader::open(&path).unwrap();
    let files = export_all(&mut reader, &directory("exported"), Format::Csv).unwrap();
    assert!(files.iter().any(|(path, rows)| path.ends_with("mavlink-rx.csv") && *rows == 800));
}

#[test]
fn exports_never_overwrite_an_input() {
    let folder = directory("export_over");
    let path = write(&folder, &records(0.5));
    let whole = fs::read(&path).unwrap();
    let keep = folder.join("keep.csv");
    fs::write(&keep, "kept").unwrap();
    let log = |arguments: &[&str], out: &Path| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_downwash"));
        let output = command.args(["log", arguments[0]]).arg(&path).args(&arguments[1..]);
        let output = output.arg("-o").arg(out).output().expect("it runs");
        (output.status.code(), String::from_utf8(output.stderr).expect("words"))
    };
    for arguments in [&["export", "--topic", "/state"][..], &["report"]] {
        let (code, words) = log(arguments, &path);
        assert_eq!(code, Some(2), "{words}");
        assert!(words.contains("choose another output"), "{words}");
        assert!(fs::read(&path).unwrap() == whole, "{arguments:?}");
    }
    let (code, words) = log(&["export", "--topic", "/stat"], &keep);
    assert_eq!(code, Some(2));
    assert!(words.contains(path.to_str().unwrap()) && words.contains("/stat "), "{words}");
    assert_eq!(fs::read(&keep).unwrap(), b"kept");
    assert_eq!(log(&["export", "--topic", "/state"], &keep).0, Some(0));
    assert!(fs::read_to_string(&keep).unwrap().starts_with("log_time_ns,"));
    let left = fs::read_dir(&folder).unwrap().count();
    assert_eq!(left, 2, "the log and the export, and no part of one");
}

#[test]
fn export_reports_damage() {
    let path = write_synced(&directory("export_damaged"), &records(0.5), 100);
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 8].iter_mut().for_each(|b| *b ^= 0xFF);
    fs::write(&path, bytes).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_downwash"));
    let output = command.args(["log", "export", "--topic", "/state"]).arg(&path).output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(words.contains("damaged") && words.contains("chunk at byte "), "{words}");
}

fn any_float() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>(), Just(f64::NAN), Just(-0.0), Just(f64::INFINITY)]
}

fn any_vector() -> impl Strategy<Value = [f64; 3]> {
    [any_float(), any_float(), any_float()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn tick_round_trips(
        position in any_vector(), velocity in any_vector(), rate in any_vector(),
        thrust_n in any_float(), saturation: u32, ns in 0..u64::MAX / 2,
    ) {
        let host = downwash::clock::HostTime::from_ns(ns);
        let state = State {
            position: Ned::from(position),
            velocity: Ned::from(velocity),
            body_rate: Frd::from(rate),
            ..State::default()
        };
        let setpoint = Setpoint { thrust_n, attitude: Euler::new(0.1, 0.2, 0.3), body_rate: Frd::from(rate) };
        let tick = Tick {
            stamp: Stamp::host(host), state, reference: None, desired: None, tube_radius_m: None,
            feedback: Setpoint::default(),
            setpoint: Some(setpoint), saturation, phase: "track", trajectory_time: None, sample_age: 0.001,
        };
        let event = Record::Event {
            host, severity: Severity::Info, source: Source::Daemon, text: "x".into(),
        };
        let bytes = fs::read(write(&directory("property"), &[Record::Tick(tick), event])).unwrap();
        let mut reader = LogReader::new(&bytes[..]).unwrap();
        let same = |a: f64, b: f64| a == b || (a.is_nan() && b.is_nan());
        let mut seen = 0;
        while let Some(message) = reader.next_message().unwrap() {
            prop_assert_eq!(message.log_time, host);
            if let Some(m) = message.decode::<StateMessage>() {
                let found = [m.p_n_m, m.p_e_m, m.p_d_m, m.v_n_mps, m.v_e_mps, m.v_d_mps, m.p_radps, m.q_radps, m.r_radps];
                let expected = position.into_iter().chain(velocity).chain(rate);
                prop_assert!(found.into_iter().zip(expected).all(|(a, b)| same(a, b)));
                seen += 1;
            } else if let Some(m) = message.decode::<SetpointMessage>() {
                prop_assert!(same(m.thrust_n, thrust_n) && same(m.yaw_rad, 0.3));
                seen += 1;
            } else if let Some(m) = message.decode::<ControlMessage>() {
                prop_assert_eq!((m.saturation, m.phase.as_str()), (saturation, "track"));
                seen += 1;
            }
        }
        prop_assert_eq!(seen, 3);
    }

    #[test]
    fn flipped_bytes_never_panic(at in 0.0..1.0f64, flip in 1u8..) {
        let path = write(&directory("flipped"), &records(0.05));
        let mut bytes = fs::read(path).unwrap();
        let at = (at * bytes.len() as f64) as usize;
        bytes[at] ^= flip;
        if let Ok(mut reader) = LogReader::new(&bytes[..]) {
            let _ = LogInfo::read(&mut reader);
        }
    }
}

/// Every signal in the shipped viewer layouts exists in the log.
#[test]
fn viewer_layouts_name_fields_of_the_log() {
    let path = write(&directory("layouts"), &records(1.0));
    let mut reader = LogReader::open(&path).unwrap();
    let mut signals = BTreeMap::new();
    while let Some(message) = reader.next_message().unwrap() {
        let channel = &message.channel;
        signals.entry(channel.topic.clone()).or_insert_with(|| {
            Layout::parse(&channel.schema, &channel.schema_data).unwrap().columns().to_vec()
        });
    }
    let exists = |topic: &str, field: &str| {
        signals.get(topic).is_some_and(|fields| fields.iter().any(|f| f == field))
    };
    let foxglove = include_str!("../config/layouts/foxglove-layout.json");
    let foxglove: serde_json::Value = serde_json::from_str(foxglove).unwrap();
    let mut checked = 0;
    for panel in foxglove["configById"].as_object().unwrap().values() {
        for path in panel["paths"].as_array().into_iter().flatten() {
            let (topic, field) = path["value"].as_str().unwrap().rsplit_once('.').unwrap();
            assert!(exists(topic, field), "{topic}.{field}");
            checked += 1;
        }
        for topic in panel["topics"].as_object().into_iter().flat_map(|t| t.keys()) {
            assert!(signals.contains_key(topic), "{topic}");
        }
    }
    let plotjuggler = include_str!("../config/layouts/plotjuggler-layout.xml");
    for curve in plotjuggler.split("<curve name=\"").skip(1) {
        let (topic, field) = curve.split_once('"').unwrap().0.rsplit_once('/').unwrap();
        assert!(exists(topic, field), "{topic}/{field}");
        checked += 1;
    }
    assert!(checked > 30);
}
