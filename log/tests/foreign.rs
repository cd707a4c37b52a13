//! Refusals name the kind of files that are often mistaken for flight logs.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use downwash_log::import::{ImportError, open};

fn place(name: &str, bytes: &[u8]) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log_foreign");
    fs::create_dir_all(&directory).expect("a folder");
    let path = directory.join(name);
    fs::write(&path, bytes).expect("a file");
    path
}

fn refusal(name: &str, bytes: &[u8]) -> String {
    let path = place(name, bytes);
    let error = open(&path, None).expect_err(name).to_string();
    assert!(error.contains(name), "{error}");
    error
}

#[test]
fn refusal_names_the_kind_of_foreign_file() {
    let encrypted = [b"ULogEnc\x01".as_slice(), &[0; 14], &[0x9B; 400]].concat();
    let noise: Vec<u8> =
        (0..5000_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    for (name, bytes, said) in [
        ("log.ulge", encrypted.as_slice(), "encrypted log of PX4"),
        ("older.ulge", &noise, "encrypted log of PX4"),
        ("empty.ulg", b"", "an empty file"),
        ("empty.tlog", b"", "an empty file"),
        ("empty.bin", b"", "an empty file"),
        ("empty.mcap", b"", "an empty file"),
        ("empty.csv", b"", "an empty file"),
        ("zeros.bin", &[0; 70_000], "zeros"),
        ("zeros.ulg", &[0; 10], "zeros"),
        (
            "text.log",
            b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\nPARM, 1, 2\n",
            "ArduPilot as text",
        ),
        (
            "older.log",
            b"ArduCopter V3.0.1\nFree RAM: 1024\nFMT,128,89,FMT,BBnNZ,Type\nATT,10,0.1,0.2,100\n",
            "ArduPilot as text",
        ),
        ("page.ulg", b"<!DOCTYPE html>\n<html><body>Not found</body></html>\n", "a web page"),
        ("flight.zip", b"PK\x03\x04 and so on", "zip"),
        ("flight.tlog.gz", b"\x1F\x8B\x08\x00 and so on", "gzip"),
        ("flight.lz4", b"\x04\x22\x4D\x18 and so on", "lz4"),
        ("flight.tar", &[[b'x'; 257].as_slice(), b"ustar\x0000 and so on"].concat(), "tar"),
        ("poses.npy", b"\x93NUMPY\x01\x00 and so on", "NumPy"),
        ("bag.bag", b"#ROSBAG V2.0\n and so on", "ROS 1"),
        ("bag.db3", b"SQLite format 3\0 and so on", "ROS 2"),
        ("points.waypoints", b"QGC WPL 110\n0\t1\t0\t16\n", "waypoints"),
        (
            "quad.params",
            b"# Onboard parameters for Vehicle 1\n#\n1\t1\tCA_AIRFRAME\t0\t6\n",
            "parameters",
        ),
        ("message.txt", b"no such file", "text without a line of numbers"),
        (
            "LICENCE.txt",
            b"Permission is hereby granted, free of charge,\nto any person, 2026\n",
            "text without a line",
        ),
        ("noise.tlog", &noise, "data of another kind"),
    ] {
        let error = refusal(name, bytes);
        assert!(error.contains(said) && error.contains("is not a flight log: expected"), "{error}");
    }
}

/// An MCAP file with one topic in the given encoding.
fn mcap(schema: &str, schema_encoding: &str, encoding: &str, body: &[u8]) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = mcap::Writer::new(&mut file).expect("a file");
    let schema = writer.add_schema(schema, schema_encoding, b"float64 x").expect("a schema");
    let channel = writer.add_channel(schema, "/drone/odom", encoding, &BTreeMap::new());
    let channel_id = channel.expect("a channel");
    for sequence in 0..50 {
        let time = 1_000_000_000 + 10_000_000 * u64::from(sequence);
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, body).expect("a message");
    }
    writer.finish().expect("an end");
    drop(writer);
    file.into_inner()
}

#[test]
fn refusal_of_foreign_mcap_lists_its_topics() {
    for (schema, schema_encoding, encoding) in [
        ("Odometry", "jsonschema", "json"),
        ("nav_msgs/msg/Odometry", "ros2msg", "cdr"),
        ("foxglove.PoseInFrame", "protobuf", "protobuf"),
    ] {
        let path = place("other.mcap", &mcap(schema, schema_encoding, encoding, b"{\"x\": 1.0}"));
        let error = open(&path, None).expect_err("nothing");
        assert!(matches!(error, ImportError::Nothing { .. }));
        let error = error.to_string();
        let said = format!("no known topic: it has /drone/odom ({schema} in {encoding})");
        assert!(error.contains(&said) && error.contains("other.mcap"), "{error}");
    }
}

#[test]
fn truncated_mcap_header_is_refused_as_unusable() {
    for bytes in [&b"\x89MCAP0\r\n"[..], b"\x89MC"] {
        let error = refusal("begun.mcap", bytes);
        assert!(error.contains("nothing in this mcap file can be used"), "{error}");
    }
}
