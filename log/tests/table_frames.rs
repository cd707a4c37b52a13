//! Tables in any world and body axes, Motive's exports among them.

use crate::table_import::{POSE, import, motive, place, pose};
use std::fs;
use std::path::Path;

use downwash_log::import::mapping::{AttitudeTurn, BodyFrame, Mapping, WorldFrame};
use downwash_log::import::open;
use proptest::prelude::*;
use vehicle::frame::{Attitude, Euler, Frd, Ned};

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
