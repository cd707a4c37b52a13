//! Tables import as flights through a mapping file, which must state everything.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use downwash_log::import::mapping::{AttitudeTurn, BodyFrame, Mapping, WorldFrame};
use downwash_log::import::{Flight, ImportError, MotorUnit, open, open_among, write};
use proptest::prelude::*;
use vehicle::frame::{Attitude, Euler, Frd, Ned};

fn place(test: &str, name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log_table").join(test);
    fs::create_dir_all(&directory).expect("a folder");
    let path = directory.join(name);
    let _ = fs::remove_file(&path);
    path
}

fn import(test: &str, table: &str, mapping: &str) -> Result<Flight, ImportError> {
    let (file, map) = (place(test, "flight.csv"), place(test, "map.toml"));
    fs::write(&file, table).expect("a file");
    fs::write(&map, mapping).expect("a file");
    open(&file, Some(&map))
}

fn refusal(test: &str, table: &str, mapping: &str) -> String {
    import(test, table, mapping).expect_err("a refusal").to_string()
}

/// The motion-capture mapping that is shipped.
const SHIPPED: &str = include_str!("../mappings/motion-capture.toml");

/// A table for it: z up, front-left-up.
fn table(rows: usize) -> String {
    let header = "t,px,py,pz,vx,vy,vz,qx,qy,qz,qw,wx,wy,wz,m1,m2,m3,m4,vbat";
    let mut text = format!("{header}\n");
    for row in 0..rows {
        let t = row as f64 * 0.01;
        let half_yaw = 0.05 * t;
        let _ = writeln!(
            text,
            "{t},1,2,3,0.1,0.2,0.3,0,0,{},{},0.01,0.02,0.1,0.5,0.51,0.52,0.53,{}",
            half_yaw.sin(),
            half_yaw.cos(),
            if row % 10 == 0 { "3.9" } else { "" },
        );
    }
    text
}

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

/// The pose part of [`SHIPPED`].
const POSE: &str = r#"
world_frame = "nwu"
body_frame = "flu"
[time]
column = "t"
unit = "s"
[position]
columns = ["px", "py", "pz"]
unit = "m"
[attitude]
quaternion = ["qx", "qy", "qz", "qw"]
order = "xyzw"
rotates = "body_to_world"
"#;

/// A pose table with this cell separator, decimal mark and line ending.
fn pose(separator: &str, decimal: &str, end: &str) -> String {
    let mut lines = vec![["t", "px", "py", "pz", "qx", "qy", "qz", "qw"].join(separator)];
    for row in 0..60 {
        let t = f64::from(row) * 0.01;
        let (s, c) = (0.1 * t).sin_cos();
        let cells = [t, 1.0 + t, 2.0, 0.5, 0.0, 0.0, s, c];
        let cells = cells.map(|cell| format!("{cell:.6}").replace('.', decimal));
        lines.push(cells.join(separator) + end);
    }
    lines.join("\r\n") + "\r\n"
}

fn assert_pose(flight: &Flight) {
    assert_eq!((flight.position.len(), flight.attitude.len()), (60, 60), "{:?}", flight.left_out);
    assert_eq!(flight.position.values()[50].to_array(), [1.5, -2.0, -0.5]);
    assert!((flight.attitude.values()[50].euler().yaw + 0.1).abs() < 1e-5);
    assert_eq!(flight.left_out, []);
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

/// An export of OptiTrack's Motive: y up, right along z, one rigid body and its markers.
fn motive(units: &str) -> String {
    let mut text = format!(
        "Format Version,1.23,Take Name,a,Rotation Type,Quaternion,Length Units,{units},Coordinate Space,Global\r\n\r\n"
    );
    let body = |name: &str| {
        let cells = |word: &str| vec![word.to_owned(); 8];
        [cells("Rigid Body"), cells(name), vec!["\"0A1B\"".to_owned(); 8]]
    };
    // The titles are above the time column; some versions shift them by one column.
    for (title, cells) in ["Type", "Name", "ID"].into_iter().zip(body("quad")) {
        let marker = if title == "Type" { "Rigid Body Marker" } else { "quad:Marker1" };
        let _ = write!(text, ",{title},{},{marker},{marker},{marker}\r\n", cells[1..].join(","));
    }
    let groups = ["Rotation"; 4].into_iter().chain(["Position"; 3]).chain(["Position"; 3]);
    let _ = write!(text, ",,{}\r\n", groups.collect::<Vec<_>>().join(","));
    text += "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z\r\n";
    for row in 0..50 {
        let t = f64::from(row) * 0.01;
        let (s, c) = (0.15 * t).sin_cos();
        let _ = write!(text, "{row},{t:.6},0,{s:.6},0,{c:.6},{t:.6},1.5,{:.6},9,9,9\r\n", -0.8 * t);
    }
    text
}

#[test]
fn shipped_mapping_reads_a_motive_export() {
    let file = place("motive", "take.csv");
    fs::write(&file, motive("Meters")).unwrap();
    let flight = open(&file, Some(Path::new("motive"))).unwrap();
    assert_eq!((flight.position.len(), flight.left_out.len()), (50, 0), "{:?}", flight.left_out);
    // Front is x, up is y, right is z: left is -z, and a positive turn about up is to the left.
    let [n, e, d] = flight.position.values()[25].to_array();
    assert!((n - 0.25).abs() < 1e-9 && (e + 0.2).abs() < 1e-9 && (d + 1.5).abs() < 1e-9);
    let attitude = flight.attitude.values()[25].euler();
    assert!((attitude.yaw + 0.075).abs() < 1e-5 && attitude.roll.abs() < 1e-6, "{attitude:?}");

    fs::write(&file, motive("Millimeters")).unwrap();
    let small = open(&file, Some(Path::new("motive"))).unwrap();
    assert!((small.position.values()[25].to_array()[2] + 0.0015).abs() < 1e-12);
    fs::write(&file, motive("Feet")).unwrap();
    let message = open(&file, Some(Path::new("motive"))).unwrap_err().to_string();
    assert!(message.contains("after \"Length Units\", found \"Feet\""), "{message}");
    fs::write(&file, motive("Meters").replace("Quaternion", "XYZ")).unwrap();
    let message = open(&file, Some(Path::new("motive"))).unwrap_err().to_string();
    assert!(message.contains("\"Rotation Type\" = \"XYZ\""), "{message}");
    // Selected by the header groups of the one body that has them.
    let columns = |group: &str, axes: &[&str]| {
        let words: Vec<_> =
            axes.iter().map(|axis| format!("[\"Rigid Body\", {group:?}, {axis:?}]")).collect();
        format!("[{}]", words.join(", "))
    };
    let (_, shipped) = downwash_log::import::mapping::SHIPPED[1];
    let words = shipped
        .replace("[7, 8, 9]", &columns("Position", &["X", "Y", "Z"]))
        .replace("[3, 4, 5, 6]", &columns("Rotation", &["X", "Y", "Z", "W"]));
    let by_words = import("motive", &motive("Meters"), &words).unwrap();
    assert_eq!(by_words.position, flight.position);
    assert_eq!(by_words.attitude, flight.attitude);
    let message = open(&file, Some(Path::new("vicon"))).unwrap_err().to_string();
    assert!(message.contains("motion-capture, motive"), "{message}");
}

#[test]
fn world_frames_with_any_axes_are_read() {
    let read = |world: &str, body: &str| {
        let mapping = POSE.replace("\"nwu\"", world).replace("\"flu\"", body);
        import("axes", &pose(",", ".", ""), &mapping)
    };
    let flight = read("[\"west\", \"south\", \"up\"]", "\"flu\"").unwrap();
    assert_eq!(flight.position.values()[0].to_array(), [-2.0, -1.0, -0.5]);
    // A left-handed world (x right, y up, z front) and a body with the same axes.
    let flight = read("[\"east\", \"up\", \"north\"]", "[\"right\", \"up\", \"front\"]").unwrap();
    assert_eq!(flight.position.values()[0].to_array(), [0.5, 1.0, -2.0]);
    // The table rotates about its z axis, which is front: right goes up, a roll to the left.
    let roll = flight.attitude.values()[50].euler().roll;
    assert!((roll.abs() - 0.1).abs() < 1e-5 && roll < 0.0, "{roll}");
    let message = read("[\"east\", \"up\", \"north\"]", "\"flu\"").unwrap_err().to_string();
    assert!(message.contains("left-handed"), "{message}");
    let message = read("[\"east\", \"up\", \"down\"]", "\"flu\"").unwrap_err().to_string();
    assert!(message.contains("along one line"), "{message}");
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
fn proposed_mapping_imports_the_table() {
    let propose = |table: &str| {
        let file = place("propose", "flight.csv");
        fs::write(&file, table).unwrap();
        downwash_log::import::propose(&file).unwrap()
    };
    for (header, cells) in [
        (
            "t,px,py,pz,vx,vy,vz,qx,qy,qz,qw,wx,wy,wz,ax,ay,az,m1,m2,m3,m4,vbat",
            "0,1,2,3,0,0,0,0,0,0,1,0,0,0,0,0,9.8,0.5,0.5,0.5,0.5,15.1",
        ),
        (
            "Time [ms];Position X (mm);Position Y (mm);Position Z (mm);Roll (deg);Pitch (deg);Yaw (deg)",
            "0;1,5;2,5;3,5;0,5;0,5;90,5",
        ),
        (
            "timestamp_us\tpos_x\tpos_y\tpos_z\tq0\tq1\tq2\tq3\tgyro_x_dps\tgyro_y_dps\tgyro_z_dps",
            "0\t1\t2\t3\t1\t0\t0\t0\t0\t0\t0",
        ),
        (
            "%time,field.pose.position.x,field.pose.position.y,field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,field.pose.orientation.w",
            "0,1,2,3,0,0,0,1",
        ),
        (
            "time_s,p_n_m,p_e_m,p_d_m,v_n_mps,v_e_mps,v_d_mps,q_w,q_x,q_y,q_z,p_radps,q_radps,r_radps",
            "0,1,2,3,0,0,0,1,0,0,0,0,0,0",
        ),
        (
            "Frame,X,Y,Z,rpm1,rpm2,rpm3,rpm4,pwm_1,pwm_2,pwm_3,pwm_4",
            "0,1,2,3,9000,9000,9000,9000,1500,1500,1500,1500",
        ),
    ] {
        let mut table = format!("{header}\n");
        for row in 0..30 {
            let (first, rest) = cells.split_at(1);
            assert_eq!(first, "0");
            let _ = writeln!(table, "{}{rest}", row * 10);
        }
        let mapping = propose(&table);
        let flight =
            import("propose", &table, &mapping).unwrap_or_else(|e| panic!("{e}\n{mapping}"));
        assert_eq!(flight.position.len(), 30, "{mapping}");
        assert!(mapping.contains("CHECK"), "{mapping}");
        assert_eq!(flight.left_out, [], "{mapping}");
    }
    let proposed = propose(
        "Time [ms];Position X (mm);Position Y (mm);Position Z (mm)\n0;1,5;2,5;3,5\n5;1,5;2,5;3,5\n",
    );
    for said in ["separator = \";\"", "unit = \"ms\"", "unit = \"mm\"", "\"Position X (mm)\""] {
        assert!(proposed.contains(said), "{said}: {proposed}");
    }
    assert!(propose(&motive("Meters")).contains("--mapping motive"));
    // Rotation angles are not taken for a position, and a mismatched quaternion order is rejected.
    let angles = propose(&motive("Meters").replace("Quaternion", "XYZ"));
    assert!(angles.contains("[position]\ncolumns = [7, 8, 9]"), "{angles}");
    let other = propose(&motive("Meters").replace("X,Y,Z,W,X,Y,Z", "W,X,Y,Z,X,Y,Z"));
    assert!(other.contains("quaternion = [\"W\", 4, 5, 6]\norder = \"wxyz\""), "{other}");

    // Vicon's export has its units below the header.
    let mut vicon = "Objects\n100\n,,quad:quad,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n\
                     ,,,,,,mm,mm,mm\n"
        .to_owned();
    let mut qualisys =
        "NO_OF_FRAMES\t30\nFREQUENCY\t100\nFrame\tTime\tX\tY\tZ\tRoll\tPitch\tYaw\tResidual\t\
                        Rot[0]\tRot[1]\tRot[2]\tRot[3]\tRot[4]\tRot[5]\tRot[6]\tRot[7]\tRot[8]\n"
            .to_owned();
    let mut spaced = "# timestamp tx ty tz qx qy qz qw\n".to_owned();
    for row in 0..30 {
        let t = f64::from(row) * 0.01;
        let _ = writeln!(vicon, "{row},0,0,0,0,1,{},500,1200", 1e3 * t);
        let _ = writeln!(
            qualisys,
            "{row}\t{t:.3}\t{}\t500\t1200\t0\t0\t0\t0.3\t1\t0\t0\t0\t1\t0\t0\t0\t1",
            1e3 * t
        );
        let _ = writeln!(spaced, "{:.3} {t:.3} 0.5 1.2 0 0 0 1", 1.7e9 + t);
    }
    for table in [vicon, qualisys, spaced] {
        let mapping = propose(&table);
        let flight =
            import("propose", &table, &mapping).unwrap_or_else(|e| panic!("{e}\n{mapping}"));
        assert_eq!((flight.position.len(), flight.attitude.len()), (30, 30), "{mapping}");
        assert_eq!(flight.left_out, [], "{mapping}");
        let [n, e, d] = flight.position.values()[20].to_array();
        assert!((n - 0.2).abs() < 1e-9 && (e + 0.5).abs() < 1e-9 && (d + 1.2).abs() < 1e-9);
    }
    let file = place("propose", "text.csv");
    fs::write(&file, "some words\nand more of them\n").unwrap();
    let message = downwash_log::import::propose(&file).unwrap_err().to_string();
    assert!(
        message.contains("text.csv") && message.contains("without a line of numbers"),
        "{message}"
    );
}

/// Columns as data sets, simulators and firmwares name them.
#[test]
fn mappings_are_proposed_for_the_names_that_others_use() {
    let propose = |header: &str, cells: &str| {
        let file = place("others", "flight.csv");
        let row = |row: i64| format!("{}{cells}\n", 1_403_636_580_000_000_000 + 5_000_000 * row);
        let table = format!("{header}\n{}", (0..30).map(row).collect::<String>());
        fs::write(&file, &table).unwrap();
        let mapping = downwash_log::import::propose(&file).unwrap();
        let flight = import("others", &table, &mapping);
        (mapping.clone(), flight.unwrap_or_else(|e| panic!("{e}\n{mapping}")))
    };
    // EuRoC: its truth holds the biases of the sensors, which are no measurements.
    let (mapping, flight) = propose(
        "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],\
         v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],b_w_RS_S_x [rad s^-1],\
         b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1]",
        ",1,2,3,1,0,0,0,0.1,0.2,0.3,5,6,7",
    );
    assert_eq!((flight.position.len(), flight.attitude.len()), (30, 30), "{mapping}");
    assert_eq!((flight.velocity.len(), flight.body_rate.len()), (30, 0), "{mapping}");
    assert!(mapping.contains("unit = \"ns\"") && mapping.contains("unit = \"m/s\"\n"), "{mapping}");
    let (mapping, flight) = propose(
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],\
         a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
        ",0.1,0.2,0.3,0.1,0.2,9.8",
    );
    assert_eq!((flight.body_rate.len(), flight.specific_force.len()), (30, 30), "{mapping}");
    assert_eq!(flight.body_rate.values()[3].to_array(), [0.1, -0.2, -0.3]);
    // A Crazyflie logs in degrees, in g and in 16 bits.
    let (mapping, flight) = propose(
        "timestamp,stateEstimate.x,stateEstimate.y,stateEstimate.z,gyro.x,gyro.y,gyro.z,\
         acc.x,acc.y,acc.z,motor.m1,motor.m2,motor.m3,motor.m4",
        ",1,2,3,40,5,6,0.01,0.02,0.99,32767.5,30000,30000,30000",
    );
    assert_eq!(flight.position.values()[3].to_array(), [1.0, -2.0, -3.0], "{mapping}");
    assert!((flight.body_rate.values()[3].to_array()[0] - 40f64.to_radians()).abs() < 1e-9);
    assert!((flight.specific_force.values()[3].to_array()[2] + 0.99 * 9.80665).abs() < 1e-9);
    assert!((flight.outputs.values()[3][0] - 0.5).abs() < 1e-4, "{mapping}");
    // Simulators: RotorPy, then gym-pybullet-drones.
    let (mapping, flight) = propose(
        "time,x,y,z,xdot,ydot,zdot,qx,qy,qz,qw,wx,wy,wz,r1,r2,r3,r4",
        ",1,2,3,0.1,0.2,0.3,0,0,0,1,0,0,0,1500,1500,1500,1500",
    );
    assert_eq!((flight.velocity.len(), flight.rotor_speed.len()), (30, 30), "{mapping}");
    let (mapping, flight) = propose(
        "timestamp,x,y,z,p,r,ya,rr,pr,yar,vx,vy,vz,wx,wy,wz",
        ",1,2,3,0.2,0.1,0.3,0,0,0,0,0,0,0,0,0",
    );
    let angles = flight.attitude.values()[3].euler();
    assert!((angles.roll - 0.1).abs() < 1e-9 && (angles.pitch + 0.2).abs() < 1e-9, "{mapping}");
    // Qualisys: the body's name stands before the first column, and its matrix is column by column.
    let (s, c) = 0.3_f64.sin_cos();
    let (mapping, flight) = propose(
        "Time [ns],quad X,Y,Z,Roll,Pitch,Yaw,Residual,Rot[0],Rot[1],Rot[2],Rot[3],Rot[4],Rot[5],\
         Rot[6],Rot[7],Rot[8]",
        &format!(",1000,2000,3000,0,0,{},0.3,{c},{s},0,{},{c},0,0,0,1", 0.3_f64.to_degrees(), -s),
    );
    assert_eq!(flight.position.values()[3].to_array(), [1.0, -2.0, -3.0], "{mapping}");
    // To the left, seen from above, is a falling heading.
    let yaw = flight.attitude.values()[3].euler().yaw;
    assert!((yaw + 0.3).abs() < 1e-9, "{yaw}: {mapping}");
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

fn any_rotation() -> impl Strategy<Value = Attitude> {
    (-3.1..3.1, -1.5..1.5, -3.1..3.1).prop_map(|(r, p, y)| Euler::new(r, p, y).attitude())
}

/// The axes of `frame` as unit vectors in its own components.
const AXES: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Rotating a vector commutes with changing axes.
    #[test]
    fn attitude_conversion_commutes_with_axis_change(
        rotation in any_rotation(),
        v in [-9.0..9.0, -9.0..9.0, -9.0..9.0f64],
        world in prop::sample::select(vec![WorldFrame::NED, WorldFrame::ENU, WorldFrame::NWU]),
        body in prop::sample::select(vec![BodyFrame::FRD, BodyFrame::FLU]),
    ) {
        let turned = world.to_ned(rotation.to_world(Frd::from(v)).to_array());
        let turn = AttitudeTurn::new(world, body).expect("one hand");
        let attitude = turn.apply(rotation);
        prop_assert!((attitude.to_world(body.to_frd(v)) - turned).norm() < 1e-9);
        // Both conversions preserve handedness.
        let [x, y, z] = AXES.map(|axis| world.to_ned(axis));
        prop_assert!((x.cross(y) - z).norm() < 1e-12);
        let [x, y, z] = AXES.map(|axis| body.to_frd(axis));
        prop_assert!((x.cross(y) - z).norm() < 1e-12);
    }

    /// A state written in any axes, units, orders and forms is read back unchanged.
    #[test]
    fn state_round_trips_through_every_table_form(
        truth in any_rotation(),
        rate in [-5.0..5.0, -5.0..5.0, -5.0..5.0f64],
        velocity in [-9.0..9.0, -9.0..9.0, -9.0..9.0f64],
        form in prop::sample::select(vec!["wxyz", "xyzw", "matrix", "euler"]),
        is_inverse: bool,
        is_body_velocity: bool,
        is_degrees: bool,
        is_flu: bool,
        world in 0usize..3,
    ) {
        // From NED and FRD into the table's axes: every conversion except ENU's is its own inverse.
        let (frame, to_table): (&str, fn(Ned) -> [f64; 3]) = [
            ("ned", (|v: Ned| v.to_array()) as fn(Ned) -> [f64; 3]),
            ("enu", |v: Ned| [v.east(), v.north(), -v.down()]),
            ("nwu", |v: Ned| [v.north(), -v.east(), -v.down()]),
        ][world];
        let to_body_table = |v: [f64; 3]| if is_flu { [v[0], -v[1], -v[2]] } else { v };
        // The matrix of the table: its columns are the table's body axes in the table's world.
        let columns = AXES.map(|axis| to_table(truth.to_world(Frd::from(to_body_table(axis)))));
        let m = |row: usize, column: usize| columns[column][row];
        let entries: Vec<f64> = (0..9).map(|k| m(k / 3, k % 3)).collect();
        let transposed: Vec<f64> = (0..9).map(|k| m(k % 3, k / 3)).collect();
        let (roll, pitch, yaw) =
            (m(2, 1).atan2(m(2, 2)), (-m(2, 0)).clamp(-1.0, 1.0).asin(), m(1, 0).atan2(m(0, 0)));
        let angle = if is_degrees { 1f64.to_degrees() } else { 1.0 };
        let q = Euler::new(roll, pitch, yaw).attitude();
        let q = if is_inverse { q.inverse() } else { q };
        let rotates = if is_inverse { "world_to_body" } else { "body_to_world" };
        let (cells, attitude) = match form {
            "euler" => (
                vec![roll * angle, pitch * angle, yaw * angle],
                format!("euler = [\"a0\", \"a1\", \"a2\"]\nunit = {:?}", if is_degrees { "deg" } else { "rad" }),
            ),
            "matrix" => (
                if is_inverse { transposed } else { entries },
                format!("matrix = {:?}\nrotates = {rotates:?}", (0..9).map(|k| format!("a{k}")).collect::<Vec<_>>()),
            ),
            order => (
                if order == "wxyz" { vec![q.w, q.x, q.y, q.z] } else { vec![q.x, q.y, q.z, q.w] },
                format!("quaternion = [\"a0\", \"a1\", \"a2\", \"a3\"]\norder = {order:?}\nrotates = {rotates:?}"),
            ),
        };
        let velocity = Ned::from(velocity);
        let speeds = match is_body_velocity {
            true => to_body_table(truth.to_body(velocity).to_array()),
            false => to_table(velocity),
        };
        let rates = to_body_table(rate).map(|r| r * angle);
        let names: Vec<String> = (0..cells.len()).map(|k| format!("a{k}")).collect();
        let all: Vec<String> =
            cells.iter().chain(&speeds).chain(&rates).map(f64::to_string).collect();
        let table = format!("{},vx,vy,vz,wx,wy,wz\n{}\n", names.join(","), all.join(","));
        let mapping = format!(
            "world_frame = {frame:?}\nbody_frame = {:?}\n[time]\nrate_hz = 100.0\n\
             [attitude]\n{attitude}\n\
             [velocity]\ncolumns = [\"vx\", \"vy\", \"vz\"]\nunit = \"m/s\"\naxes = {:?}\n\
             [body_rate]\ncolumns = [\"wx\", \"wy\", \"wz\"]\nunit = {:?}\naxes = \"body\"\n",
            if is_flu { "flu" } else { "frd" },
            if is_body_velocity { "body" } else { "world" },
            if is_degrees { "deg/s" } else { "rad/s" },
        );
        let flight = import("property", &table, &mapping).unwrap();
        prop_assert_eq!(&flight.left_out, &vec![]);
        prop_assert!(flight.attitude.values()[0].angle_to(truth) < 1e-6);
        prop_assert!((flight.velocity.values()[0] - velocity).norm() < 1e-6);
        prop_assert!((flight.body_rate.values()[0] - Frd::from(rate)).norm() < 1e-9);
    }

    #[test]
    fn arbitrary_text_never_panics_the_mapping_parser(text in "[ -~\n]{0,200}") {
        let _ = Mapping::parse(&text);
    }
}
