//! Tables import as flights through a mapping file, which must state everything.

use crate::table_import::{
    POSE, SHIPPED, assert_pose, import, motive, place, pose, refusal, table,
};
use std::fmt::Write;
use std::fs;
use std::path::Path;

use downwash_log::import::{ImportError, MotorUnit, open, open_among, write};

#[test]
fn shipped_mapping_reads_a_motion_capture_table() {
    let flight = import("shipped", &table(200), SHIPPED).unwrap();
    assert_eq!(flight.position.values()[0].to_array(), [1.0, -2.0, -3.0]);
    assert_eq!(flight.velocity.values()[0].to_array(), [0.1, -0.2, -0.3]);
    assert_eq!(flight.body_rate.values()[0].to_array(), [0.01, -0.02, -0.1]);
    assert_eq!(flight.outputs.values()[0], [0.5, 0.51, 0.52, 0.53]);
    assert_eq!((flight.voltage.len(), flight.voltage.values()[0]), (20, 3.9));
    // Turning left, seen from above, is a falling heading.
    let yaw = flight.attitude.values()[199].euler().yaw;
    assert!((yaw + 0.199).abs() < 1e-9, "{yaw}");
    assert_eq!(flight.rows.as_ref().unwrap().len(), 200);
    assert_eq!(flight.rows.as_deref(), Some(flight.attitude.times()));
    assert_eq!((flight.left_out.len(), flight.origin.format), (0, "csv"));
}

#[test]
fn unusable_rows_are_dropped_and_counted() {
    let sound = table(50);
    let mut lines: Vec<String> = sound.lines().map(str::to_owned).collect();
    lines[10] = lines[10].replacen(",1,2,3,", ",nan,2,3,", 1);
    lines[12] = lines[12].replacen(",1,2,3,", ",,2,3,", 1);
    lines[14] = lines[14].replacen(",1,2,3,", ",1,2,", 1);
    lines[16] = lines[15].clone();
    lines[18] = lines[18].replacen("0.17,", "0.05,", 1);
    lines[20] = lines[20].replacen(",0.52,", ",words,", 1);
    lines.drain(30..40);
    let cut = lines.last().unwrap().len() / 2;
    lines.last_mut().unwrap().truncate(cut);
    let flight = import("unusable", &lines.join("\n"), SHIPPED).unwrap();
    let left_out = |words: &str| {
        flight.left_out.iter().filter(|(what, _)| what.contains(words)).map(|(_, n)| n).sum::<u64>()
    };
    assert_eq!(left_out("not a finite number"), 3);
    assert_eq!(left_out("more or fewer cells"), 2);
    assert_eq!(left_out("time of the row before"), 1);
    assert_eq!(left_out("earlier time"), 1);
    assert_eq!(left_out("gap"), 1);
    assert_eq!(flight.rows.unwrap().len(), 50 - 7 - 10);
}

#[test]
fn missing_mapping_settings_are_named_in_the_error() {
    let without = |line: &str| {
        let kept: Vec<_> = SHIPPED.lines().filter(|l| !l.starts_with(line)).collect();
        refusal("unsaid", &table(3), &kept.join("\n"))
    };
    for (line, asked) in [
        ("world_frame", "world_frame = \"ned\""),
        ("body_frame", "body_frame = \"frd\""),
        ("order", "attitude.order = \"wxyz\""),
        ("rotates", "attitude.rotates = \"body_to_world\""),
        ("axes", "velocity.axes = \"world\""),
        ("unit", ".unit = \""),
        ("meaning", "motors.meaning = \"thrust_fraction\""),
    ] {
        let message = without(line);
        assert!(message.contains(asked), "without {line}: {message}");
        assert!(message.contains("map.toml") && message.contains("flight.csv"), "{message}");
    }
    let message = refusal("unsaid", &table(3).replacen("qw", "q0", 1), SHIPPED);
    assert!(message.contains("no column \"qw\"; it has t, px"), "{message}");
    let message = refusal("unsaid", &table(3), &format!("colour = \"red\"\n{SHIPPED}"));
    assert!(message.contains("colour") && message.contains("map.toml"), "{message}");
    let message = refusal("unsaid", &table(3), &SHIPPED.replace("= \"nwu\"", "= \"up\""));
    assert!(message.contains("enu"), "{message}");
    let pwm = "meaning = \"pwm\"";
    let pwm = SHIPPED.replacen("meaning = \"thrust_fraction\"", pwm, 1);
    assert!(refusal("unsaid", &table(3), &pwm).contains("polynomial_N"));
    assert!(refusal("unsaid", "", SHIPPED).contains("empty"));
    let file = place("unsaid", "alone.csv");
    fs::write(&file, table(3)).unwrap();
    assert!(matches!(open(&file, None), Err(ImportError::NoMapping { .. })));
    let message = refusal("unsaid", &table(3), "[time]\nrate_hz = 0.0\n");
    assert!(message.contains("rate above 0"), "{message}");
}

#[test]
fn motors_of_every_unit_are_read() {
    let motors = |lines: &str, value: f64| {
        let table = format!("m1,m2,m3,m4\n{value},0,{value},0\n");
        let columns = "columns = [\"m3\", \"m2\", \"m1\", \"m4\"]";
        let mapping = format!("[time]\nrate_hz = 100.0\n[motors]\n{columns}\n{lines}\n");
        let flight = import("motors", &table, &mapping).unwrap();
        (flight.outputs.values()[0][0], flight.motor_unit, flight.rotor_speed)
    };
    let (u, unit, _) = motors("meaning = \"pwm\"\nrange = [1000, 2000]", 1250.0);
    assert_eq!((u, unit), (0.25, MotorUnit::ThrustFraction));
    let (thrust, unit, _) =
        motors("meaning = \"pwm\"\nrange = [0, 65535]\npolynomial_N = [0.01, 0.1, 0.2]", 65535.0);
    assert!((thrust - 0.31).abs() < 1e-12 && unit == MotorUnit::Newton);
    let speed = "meaning = \"rotor_speed\"\nunit = \"rpm\"\nthrust_coefficient_N_s2 = 1e-6";
    let (thrust, unit, speeds) = motors(speed, 6000.0);
    let expected = 6000.0 * std::f64::consts::TAU / 60.0;
    assert!((thrust - 1e-6 * expected * expected).abs() < 1e-9 && unit == MotorUnit::Newton);
    assert!((speeds.values()[0][0] - expected).abs() < 1e-9);
    let (thrust, unit, _) = motors("meaning = \"thrust_N\"", 1.5);
    assert_eq!((thrust, unit), (1.5, MotorUnit::Newton));
}

#[test]
fn every_csv_dialect_is_read() {
    for (separator, decimal, end) in [
        (",", ".", ","),
        (";", ",", ""),
        (";", ".", ";"),
        ("\t", ",", ""),
        ("\t", ".", "\t\t"),
        ("|", ".", ""),
        (" ", ".", ""),
        (", ", ".", " ,"),
    ] {
        let table = pose(separator, decimal, end);
        assert_pose(&import("dialects", &table, POSE).unwrap());
        let sep = if separator == " " { separator } else { separator.trim_matches(' ') };
        let sep = format!("sep={sep}\r\n{table}");
        assert_pose(&import("dialects", &sep, POSE).unwrap());
    }
    // A header that ends with a separator, while the rows do not.
    let mut table = pose(",", ".", "");
    table.insert(table.find('\r').unwrap(), ',');
    assert_pose(&import("dialects", &table, POSE).unwrap());
    // Commas between cells and inside quoted cells.
    let quote = |line: &str| format!("\"{}\"\r\n", line.replace(';', "\",\""));
    let quoted: String = pose(";", ",", "").lines().map(quote).collect();
    assert_pose(&import("dialects", &quoted, POSE).unwrap());
    // Header after a comment character, as in plain-text trajectories.
    let marked = format!("# {}", pose(" ", ".", ""));
    assert_pose(&import("dialects", &marked, POSE).unwrap());
    let stated = format!("separator = \";\"\ndecimal = \",\"\n{POSE}");
    assert_pose(&import("dialects", &pose(";", ",", ""), &stated).unwrap());
}

#[test]
fn mixed_decimal_marks_are_refused_until_one_is_stated() {
    let table = pose(";", ",", "").replacen("0,500000", "0.500000", 1);
    let message = refusal("marks", &table, POSE);
    assert!(message.contains("write decimal = \".\""), "{message}");
    let stated = format!("decimal = \",\"\n{POSE}");
    let flight = import("marks", &table, &stated).unwrap();
    assert_eq!((flight.position.len(), flight.left_out.len()), (59, 1));
}

#[test]
fn utf_16_tables_are_read() {
    let table = pose(",", ".", "");
    for (mark, big) in [(true, false), (true, true), (false, false), (false, true)] {
        let mut bytes: Vec<u8> = Vec::new();
        for unit in mark.then_some(0xFEFF).into_iter().chain(table.encode_utf16()) {
            bytes.extend(if big { u16::to_be_bytes(unit) } else { u16::to_le_bytes(unit) });
        }
        let (file, map) = (place("utf16", "flight.csv"), place("utf16", "map.toml"));
        fs::write(&file, bytes).unwrap();
        fs::write(&map, POSE).unwrap();
        assert_pose(&open(&file, Some(&map)).unwrap());
    }
}

#[test]
fn header_row_is_found_or_set_by_skip_lines() {
    let table = pose(",", ".", "");
    let preamble = "Recorded by a laboratory\r\n\r\nrate,100\r\nX,Y\r\n";
    assert_pose(&import("preamble", &format!("{preamble}{table}"), POSE).unwrap());
    // The unit row below the header is not data.
    let units = table.replacen("\r\n", "\r\n(s),(m),(m),(m),,,,\r\n", 1);
    let flight = import("preamble", &units, POSE).unwrap();
    assert_pose(&flight);
    // `skip_lines` skips an earlier line with the same names.
    let twice = format!("{}{table}", "t,px,py,pz,qx,qy,qz,qw\r\nold,1,2\r\n");
    assert_pose(&import("preamble", &twice, &format!("skip_lines = 2\n{POSE}")).unwrap());
}

#[test]
fn columns_are_found_by_number_or_by_header_groups() {
    let by_number = POSE
        .replace("\"t\"", "1")
        .replace("[\"px\", \"py\", \"pz\"]", "[2, 3, 4]")
        .replace("[\"qx\", \"qy\", \"qz\", \"qw\"]", "[5, 6, 7, 8]");
    let table = pose(",", ".", "");
    assert_pose(&import("numbers", &table, &by_number).unwrap());
    let (_, rows) = table.split_once("\r\n").unwrap();
    assert_pose(&import("numbers", rows, &by_number).unwrap());
    let message = refusal("numbers", rows, &by_number.replace("[2, 3, 4]", "[2, 3, 40]"));
    assert!(message.contains("number 40"), "{message}");

    let same = table.replacen("t,px,py,pz,qx,qy,qz,qw", "t,x,y,z,x,y,z,w", 1);
    let message = refusal("words", &same, &POSE.replace("\"px\"", "\"x\""));
    assert!(message.contains("2 columns \"x\": 2 (x), 5 (x)"), "{message}");
    let above = format!(",pos,pos,pos,rot,rot,rot,rot\r\n{same}");
    let words = |group: &str, axes: &[&str]| {
        let columns: Vec<_> = axes.iter().map(|axis| format!("[{group:?}, {axis:?}]")).collect();
        columns.join(", ")
    };
    let mapping = POSE
        .replace("\"px\", \"py\", \"pz\"", &words("pos", &["x", "y", "z"]))
        .replace("\"qx\", \"qy\", \"qz\", \"qw\"", &words("rot", &["x", "y", "z", "w"]));
    assert_pose(&import("words", &above, &mapping).unwrap());
}

#[test]
fn table_that_contradicts_its_mapping_is_refused() {
    let table = pose(",", ".", "");
    let units = |line: &str| table.replacen("\r\n", &format!("\r\n{line}\r\n"), 1);
    assert_pose(&import("contrary", &units("s,m,m,m,,,,"), POSE).unwrap());
    let message = refusal("contrary", &units("s,mm,mm,mm,,,,"), POSE);
    assert!(message.contains("column 2 (px) is in \"mm\""), "{message}");
    let message = refusal("contrary", &units("[ms],[m],[m],[m],-,-,-,-"), POSE);
    assert!(message.contains("time.column") && message.contains("\"ms\""), "{message}");
    let (named, map) = (table.replacen("px", "px [cm]", 1), POSE.replace("px", "px [cm]"));
    let message = refusal("contrary", &named, &map);
    assert!(message.contains("is in \"cm\""), "{message}");
    // Units that a mapping cannot state are contradictions too, and no reason to guess.
    for unit in ["ft", "km", "inches"] {
        let name = format!("px [{unit}]");
        let (named, map) = (table.replacen("px", &name, 1), POSE.replace("px", &name));
        assert!(refusal("contrary", &named, &map).contains("column 2 (px"), "{unit}");
    }
    let named = table.replacen("t,", "t [\u{b5}s],", 1);
    let map = POSE.replace("\"t\"", "\"t [\u{b5}s]\"");
    assert!(refusal("contrary", &named, &map).contains("is in \"us\""));
    // The names of the quaternion columns contradict the configured order.
    let message = refusal("contrary", &table, &POSE.replace("xyzw", "wxyz"));
    assert!(message.contains("the order is \"wxyz\", but the columns are 5 (qx)"), "{message}");
    let file = place("contrary", "take.csv");
    for names in ["W,X,Y,Z,X,Y,Z", "X,Y,Z,X,Y,Z,W"] {
        fs::write(&file, motive("Meters").replace("X,Y,Z,W,X,Y,Z", names)).unwrap();
        let message = open(&file, Some(Path::new("motive"))).unwrap_err().to_string();
        assert!(message.contains("the order is \"xyzw\""), "{message}");
    }
}

#[test]
fn streams_keep_their_own_rows_and_rates() {
    // A 50 Hz pose and a 200 Hz gyro joined by time in one table.
    let mut table = "t,px,py,pz,qx,qy,qz,qw,wx,wy,wz\n".to_owned();
    for row in 0..200 {
        let t = f64::from(row) * 0.005;
        let pose = if row % 4 == 0 { format!("{t},2,3,0,0,0,1") } else { ",,,,,,".to_owned() };
        let rate = if row % 4 == 0 && row % 8 == 0 { "NaN,NaN,NaN" } else { "0.1,0.2,0.3" };
        let _ = writeln!(table, "{t},{pose},{rate}");
    }
    let rate =
        "[body_rate]\ncolumns = [\"wx\", \"wy\", \"wz\"]\nunit = \"rad/s\"\naxes = \"body\"\n";
    let flight = import("own_rows", &table, &format!("{POSE}{rate}")).unwrap();
    assert_eq!(
        (flight.position.len(), flight.attitude.len(), flight.body_rate.len()),
        (50, 50, 175)
    );
    assert_eq!(flight.left_out, []);
}

#[test]
fn unusable_table_error_says_why() {
    let table = pose(",", ".", "").replace("\r\n0", "\r\nextra,0");
    let message = refusal("nothing", &table, POSE);
    assert!(message.contains("row 1 has 9 cells where the header has 8"), "{message}");
    assert!(message.contains("60 x row with more or fewer cells"), "{message}");
}

#[test]
fn times_may_be_dates() {
    let mapping = "world_frame = \"ned\"\n[time]\ncolumn = \"time\"\nunit = \"iso8601\"\n\
                   [position]\ncolumns = [\"x\", \"y\", \"z\"]\nunit = \"m\"\n";
    for (from, start) in [("2024-03-01T23:59:5", 1_709_337_590.0), ("23:59:5", 86_390.0)] {
        let row = |k: i32| format!("{from}{}.{:02}0,1,2,3\n", k / 100, k % 100);
        let table = format!("time,x,y,z\n{}", (0..900).map(row).collect::<String>());
        let flight = import("dates", &table, mapping).expect("a flight");
        assert_eq!((flight.position.len(), flight.left_out.len()), (900, 0));
        let times = flight.position.times();
        assert!((times[0] - start).abs() < 1e-5 && (times[899] - start - 8.99).abs() < 1e-5);
        let file = place("dates", "flight.csv");
        fs::write(&file, &table).unwrap();
        let proposed = downwash_log::import::propose(&file).unwrap();
        assert!(proposed.contains("unit = \"iso8601\"\n"), "{proposed}");
    }
}

#[test]
fn a_mapping_with_a_column_too_many_is_refused() {
    let mapping = POSE.replacen("\"pz\"]", "\"pz\", \"t\"]", 1);
    assert_ne!(mapping, POSE);
    let message = refusal("too-many", &pose(",", ".", ""), &mapping);
    assert!(message.contains("map.toml") && message.contains("length 4"), "{message}");
}

#[test]
fn imported_table_round_trips_through_a_log() {
    let flight = import("round_trip", &table(300), SHIPPED).unwrap();
    let path = place("round_trip", "flight.mcap");
    assert!(write(&flight, &path).unwrap() > 300 * 6);
    let back = open(&path, None).unwrap();
    assert_eq!(back.attitude, flight.attitude);
    assert_eq!(back.outputs, flight.outputs);
    assert_eq!(back.voltage, flight.voltage);
    assert_eq!(back.rows, flight.rows);
    assert_eq!((back.motor_unit, back.motor_source), (flight.motor_unit, flight.motor_source));
    assert!(open(&path, Some(&place("round_trip", "no.toml"))).is_err());
}

#[test]
fn mapping_applies_only_to_tables_among_mixed_logs() {
    let flight = import("mixed", &table(300), SHIPPED).unwrap();
    let (log, csv, map) = (
        place("mixed", "flight.mcap"),
        flight.origin.path.clone(),
        place("mixed", "map-of-all.toml"),
    );
    write(&flight, &log).unwrap();
    fs::write(&map, SHIPPED).unwrap();
    assert_eq!(open_among(&log, Some(&map)).unwrap().attitude, flight.attitude);
    assert_eq!(open_among(&csv, Some(&map)).unwrap().attitude, flight.attitude);
    assert!(matches!(open_among(&csv, None), Err(ImportError::NoMapping { .. })));
}
