//! The fuzz targets' functions on random bytes, including nearly valid frames and logs.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::LazyLock;

use crate::log_flight::{records, write};
use proptest::prelude::*;
use wire::Encoder;
use wire::dialect::MavMessage;

#[path = "../fuzz/src/lib.rs"]
mod fuzz;

/// The messages that the link decodes, and some that it does not.
const IDS: &[u32] = &[
    0, 1, 22, 24, 26, 27, 30, 31, 32, 36, 77, 82, 83, 105, 111, 116, 129, 147, 148, 245, 253, 291,
    331, 375, 436,
];

/// A frame with any payload, values included.
fn any_frame() -> impl Strategy<Value = Vec<u8>> {
    let payload = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..255),
        prop::collection::vec(prop::sample::select(vec![0u8, 1, 2, 3, 12, 0x7F, 0xFF]), 0..255),
    ];
    (prop::sample::select(IDS), payload).prop_filter_map("no such value", |(id, payload)| {
        let message: MavMessage =
            mavlink::Message::parse(mavlink::MavlinkVersion::V2, id, &payload).ok()?;
        let mut bytes = Vec::new();
        Encoder::new(1, 1).encode(&message, &mut bytes);
        Some(bytes)
    })
}

/// A line of a parameter file: usually a known name, with any number.
fn any_parameter() -> impl Strategy<Value = String> {
    use downwash::parameters::Autopilot;
    let names = |autopilot: Autopilot| prop::sample::select(autopilot.parameter_names());
    let name = prop_oneof![names(Autopilot::Px4), names(Autopilot::ArduCopter)];
    let value = prop_oneof![
        3 => (-5i32..130).prop_map(f64::from),
        1 => any::<f64>(),
    ];
    (name, value).prop_map(|(name, value)| format!("{name} {value}"))
}

/// A token of a formula, usually a valid one.
fn any_token() -> impl Strategy<Value = &'static str> {
    prop::sample::select(vec![
        "air_x", "airspeed", "rate_z", "heading", "thrust", "height", "tilt", "voltage", "time",
        "c", "1", "0", "-3e8", "1e300", "0.3", "[N]", "[m/s]", "[N m]", "[s]", "[kg", "+", "-",
        "*", "/", "^", "^2", "^-8", "^0.5", "(", ")", "abs(", "sqrt(", "exp(", "sin(", "min(", ",",
        ";", "=", " ",
    ])
}

/// Chunks with their control bytes, as the link target reads them.
fn any_input() -> impl Strategy<Value = Vec<u8>> {
    let chunk = prop_oneof![
        4 => any_frame(),
        1 => prop::collection::vec(any::<u8>(), 0..255),
    ];
    let calm = prop_oneof![3 => Just(4u8), 1 => any::<u8>()];
    prop::collection::vec((calm, chunk), 0..40).prop_map(|chunks| {
        let mut input = Vec::new();
        for (control, chunk) in chunks {
            let chunk = &chunk[..chunk.len().min(255)];
            input.push(control);
            input.push(chunk.len() as u8);
            input.extend_from_slice(chunk);
        }
        input
    })
}

/// Entries of a telemetry log, some with extreme timestamps.
fn any_stamped_frames() -> impl Strategy<Value = Vec<u8>> {
    let stamp = prop_oneof![
        4 => 1_700_000_000_000_000u64..1_700_000_100_000_000,
        1 => 946_684_800_000_000u64..4_102_444_800_000_000,
        1 => any::<u64>(),
    ];
    prop::collection::vec((stamp, any_frame()), 0..60).prop_map(|entries| {
        entries
            .into_iter()
            .flat_map(|(stamp, frame)| [&stamp.to_be_bytes()[..], &frame].concat())
            .collect()
    })
}

/// A whole log of a short flight.
static LOG: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fuzz_targets");
    let _ = std::fs::remove_dir_all(&directory);
    std::fs::read(write(&directory, &records(0.2))).unwrap()
});

/// The names in a folder, without their extensions.
fn names(folder: &Path) -> BTreeSet<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths.map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned()).collect()
}

/// The corpus is what the fuzzer found: inputs that reach different code.
#[test]
fn corpus_never_panics_its_target() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz");
    let targets: BTreeSet<String> =
        fuzz::TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    for folder in ["fuzz_targets", "corpus"] {
        assert_eq!(names(&root.join(folder)), targets, "{folder}");
    }
    for (name, target) in fuzz::TARGETS {
        for entry in std::fs::read_dir(root.join("corpus").join(name)).unwrap() {
            let path = entry.unwrap().path();
            // Shown if the target panics.
            println!("{}", path.display());
            target(&std::fs::read(&path).unwrap());
        }
    }
}

/// An MCAP record.
fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode], &(body.len() as u64).to_le_bytes()[..], body].concat()
}

/// Found by the fuzzer: a record that is longer than the uncompressed chunk around it.
#[test]
fn records_longer_than_their_chunk_never_panic_the_flight_log() {
    let records = [&[4], &1000_u64.to_le_bytes()[..], &[0; 20]].concat();
    let size = (records.len() as u64).to_le_bytes();
    // Start and end time, uncompressed size, no checksum, no compression, size.
    let chunk = [&[0; 16][..], &size, &[0; 4], &[0; 4], &size, &records].concat();
    for after in [0, 5, 2000] {
        fuzz::flight_log(&[record(6, &chunk), vec![0; after]].concat());
        fuzz::flight_log(&record(6, &[&chunk[..], &vec![0; after]].concat()));
    }
}

#[test]
fn truncated_attachments_never_panic_the_flight_log() {
    // Times, an empty name and media type, no data, a checksum.
    let attachment = [0; 16 + 4 + 4 + 8 + 4];
    for length in 0..=attachment.len() {
        fuzz::flight_log(&record(9, &attachment[..length]));
    }
}

/// A name that no mapping accepts and that is not text.
#[test]
fn control_characters_in_names_never_panic_the_proposal() {
    fuzz::table(b"t\t\x0E\n0\t1\n");
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic_the_link(input in any_input()) {
        fuzz::link(&input);
    }

    #[test]
    fn arbitrary_bytes_never_panic_the_telemetry_log(input in any_input()) {
        fuzz::tlog(&input);
    }

    #[test]
    fn arbitrary_bytes_never_panic_the_import(input in any_stamped_frames()) {
        fuzz::import(&input);
    }

    #[test]
    fn arbitrary_rows_never_panic_the_onboard_log(
        rows in prop::collection::vec(
            (prop::sample::select(vec![b'D', b'A', b'F', b'S', 0x95]), prop::collection::vec(any::<u8>(), 0..40)),
            0..60,
        ),
    ) {
        let mut ulog = Vec::new();
        let mut dataflash = Vec::new();
        for (kind, body) in rows {
            ulog.extend([body.len() as u8, 0, kind]);
            ulog.extend(&body);
            dataflash.extend([0xA3, 0x95, 1]);
            dataflash.extend(&body[..body.len().min(14)]);
        }
        fuzz::onboard(&ulog);
        fuzz::onboard(&dataflash);
    }

    #[test]
    fn arbitrary_tables_never_panic_the_import(
        rows in prop::collection::vec("[-0-9.,einfa\"]{0,40}|[0-9]{1,3}(,[-0-9.]{1,6}){18}", 0..20),
    ) {
        let header = "t,px,py,pz,vx,vy,vz,qx,qy,qz,qw,wx,wy,wz,m1,m2,m3,m4,vbat\n";
        fuzz::import(format!("{header}{}", rows.join("\n")).as_bytes());
    }

    #[test]
    fn arbitrary_table_dialects_never_panic_the_import(
        above in prop::collection::vec("[ -~]{0,30}", 0..4),
        names in prop::collection::vec("(t|time|px|X|Y|Z|W|qx|q_w|roll|m1|vbat|\"|#|é| \\[ms\\]|[a-z_]{0,4})", 1..14),
        rows in prop::collection::vec(prop::collection::vec("-?[0-9]{0,3}[.,]?[0-9]{0,3}|NaN|\"|", 0..14), 0..12),
        separator in prop::sample::select(vec![",", ";", "\t", "|"]),
        end in prop::sample::select(vec!["\n", "\r\n", ",\n", ";\r\n"]),
        encoding in 0..4,
    ) {
        let lines = above.into_iter().chain([names.join(separator)]);
        let lines: Vec<String> = lines.chain(rows.iter().map(|row| row.join(separator))).collect();
        let text = lines.join(end) + end;
        let units = || text.encode_utf16();
        let bytes: Vec<u8> = match encoding {
            0 => text.clone().into_bytes(),
            1 => [b"\xEF\xBB\xBF", text.as_bytes()].concat(),
            2 => [0xFEFF].into_iter().chain(units()).flat_map(u16::to_le_bytes).collect(),
            _ => units().flat_map(u16::to_be_bytes).collect(),
        };
        fuzz::table(&bytes);
    }

    #[test]
    fn arbitrary_bytes_never_panic_the_table_reader(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        fuzz::table(&bytes);
    }

    #[test]
    fn arbitrary_parameters_give_valid_vehicle_toml(lines in prop::collection::vec(any_parameter(), 0..40)) {
        fuzz::parameters(lines.join("\n").as_bytes());
    }

    #[test]
    fn arbitrary_formulas_never_panic_the_law_parser(
        channel in prop::sample::select(vec!["force_x", "force_down", "moment_z", "thrust", "lag"]),
        tokens in prop::collection::vec(any_token(), 0..24),
    ) {
        let formula = tokens.concat();
        fuzz::law(format!("{channel} = {formula}").as_bytes());
        fuzz::law(format!("[law.a]\n{channel} = \"{formula}\"\nconstants = {{ c = \"{formula}\" }}\n").as_bytes());
    }

    #[test]
    fn arbitrary_text_never_panics_the_law_parser(text in "\\PC{0,200}") {
        fuzz::law(text.as_bytes());
    }

    #[test]
    fn arbitrary_bytes_never_panic_the_mocap_bridge(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        fuzz::mocap(&bytes);
    }

    #[test]
    fn arbitrary_room_lines_never_panic_the_mocap_bridge(
        lines in prop::collection::vec(
            (
                prop::sample::select(vec!["1", "2", ""]),
                prop_oneof![0.0..1.0f64, any::<f64>()],
                prop::array::uniform3(prop_oneof![3 => -1.0..1.0f64, 1 => any::<f64>()]),
                prop::array::uniform4(prop_oneof![3 => Just(0.5), 1 => any::<f64>()]),
            ),
            0..40,
        ),
    ) {
        let line = |(body, t, p, q): &(&str, f64, [f64; 3], [f64; 4])| {
            format!("{{\"body\":\"{body}\",\"t\":{t:e},\"p\":{p:?},\"q\":{q:?}}}\n")
        };
        fuzz::mocap(lines.iter().map(line).collect::<String>().as_bytes());
    }

    #[test]
    fn arbitrary_text_never_panics_the_endpoint_parser(input in "(udpin|tcp|serial|udp)?:?(//)?[ -~]{0,20}") {
        fuzz::endpoint(input.as_bytes());
    }

    #[test]
    fn arbitrary_bytes_never_panic_the_flight_log(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        fuzz::flight_log(&bytes);
    }

    #[test]
    fn damaged_flight_log_never_panics_the_reader(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20),
        length in any::<prop::sample::Index>(),
    ) {
        let mut log = LOG.clone();
        for (at, byte) in changes {
            let at = at.index(log.len());
            log[at] = byte;
        }
        log.truncate(length.index(log.len()) + 1);
        fuzz::flight_log(&log);
        fuzz::import(&log);
    }
}
