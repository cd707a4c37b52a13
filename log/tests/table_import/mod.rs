//! Tables with their mappings, written into files and imported.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use downwash_log::import::{Flight, ImportError, open};

pub fn place(test: &str, name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log_table").join(test);
    fs::create_dir_all(&directory).expect("a folder");
    let path = directory.join(name);
    let _ = fs::remove_file(&path);
    path
}

pub fn import(test: &str, table: &str, mapping: &str) -> Result<Flight, ImportError> {
    let (file, map) = (place(test, "flight.csv"), place(test, "map.toml"));
    fs::write(&file, table).expect("a file");
    fs::write(&map, mapping).expect("a file");
    open(&file, Some(&map))
}

pub fn refusal(test: &str, table: &str, mapping: &str) -> String {
    import(test, table, mapping).expect_err("a refusal").to_string()
}

/// The pose part of [`SHIPPED`].
pub const POSE: &str = r#"
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
pub fn pose(separator: &str, decimal: &str, end: &str) -> String {
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

pub fn assert_pose(flight: &Flight) {
    assert_eq!((flight.position.len(), flight.attitude.len()), (60, 60), "{:?}", flight.left_out);
    assert_eq!(flight.position.values()[50].to_array(), [1.5, -2.0, -0.5]);
    assert!((flight.attitude.values()[50].euler().yaw + 0.1).abs() < 1e-5);
    assert_eq!(flight.left_out, []);
}

/// A table for it: z up, front-left-up.
pub fn table(rows: usize) -> String {
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

/// The motion-capture mapping that is shipped.
pub const SHIPPED: &str = include_str!("../../mappings/motion-capture.toml");

/// An export of OptiTrack's Motive: y up, right along z, one rigid body and its markers.
pub fn motive(units: &str) -> String {
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
