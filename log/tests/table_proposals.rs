//! Mappings proposed from the header and the first rows of a table.

use crate::table_import::{import, motive, place};
use std::fmt::Write;
use std::fs;

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

/// A Crazyflie's pitch rises with the nose, against the rotation about the axis to its left.
#[test]
fn angles_of_a_crazyflie_have_their_signs() {
    let propose = |header: &str, cells: &str| {
        let file = place("crazyflie", "flight.csv");
        let rows: String = (0..30).map(|row| format!("{}{cells}\n", 10 * row)).collect();
        let table = format!("{header}\n{rows}");
        fs::write(&file, &table).unwrap();
        let mapping = downwash_log::import::propose(&file).unwrap();
        let flight = import("crazyflie", &table, &mapping);
        (mapping.clone(), flight.unwrap_or_else(|e| panic!("{e}\n{mapping}")))
    };
    let angles = |flight: &downwash_log::import::Flight| {
        let euler = flight.attitude.values()[3].euler();
        [euler.roll, euler.pitch, euler.yaw].map(|angle| angle.to_degrees().round())
    };
    for group in ["stabilizer", "stateEstimate"] {
        // Small angles are degrees too, and a setpoint is no attitude.
        let (mapping, flight) = propose(
            &format!(
                "Timestamp,controller.roll,controller.pitch,controller.yaw,{group}.roll,{group}.pitch,\
                 {group}.yaw,gyro.x,gyro.y,gyro.z"
            ),
            ",1,1,1,2,4,3,0.5,-0.5,0.25",
        );
        // Nose up, right wing down, nose to the left.
        assert_eq!(angles(&flight), [2.0, 4.0, -3.0], "{mapping}");
        let rate = flight.body_rate.values()[3].to_array().map(f64::to_degrees);
        let expected = [0.5, 0.5, -0.25];
        assert!(rate.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{rate:?} {mapping}");
        assert!(mapping.contains("Not used: controller.roll"), "{mapping}");
    }
    // The quaternion has no such sign, and is preferred. Accelerations of the estimate are in world axes.
    let (s, c) = 0.1_f64.sin_cos();
    let (mapping, flight) = propose(
        "Timestamp,stabilizer.roll,stabilizer.pitch,stabilizer.yaw,stateEstimate.qx,stateEstimate.qy,\
         stateEstimate.qz,stateEstimate.qw,stateEstimate.ax,stateEstimate.ay,stateEstimate.az",
        &format!(",0,{},0,0,{},0,{c},0.1,0,0", 0.2_f64.to_degrees(), -s),
    );
    assert!(!mapping.contains("minus") && mapping.contains("axes = \"world\""), "{mapping}");
    assert!((flight.attitude.values()[3].euler().pitch - 0.2).abs() < 1e-9, "{mapping}");
}

#[test]
fn any_column_can_have_the_opposite_sign() {
    let table = "t,x,y,z,roll,pitch,yaw\n0,1,2,3,0.1,0.2,0.3\n1,1,2,3,0.1,0.2,0.3\n";
    let read = |position: &str, pitch: &str| {
        let mapping = format!(
            "world_frame = \"ned\"\nbody_frame = \"frd\"\n[time]\ncolumn = \"t\"\nunit = \"s\"\n\
             [position]\ncolumns = {position}\nunit = \"m\"\n\
             [attitude]\neuler = [\"roll\", {pitch}, \"yaw\"]\nunit = \"rad\"\n"
        );
        import("opposite", table, &mapping)
    };
    let flight =
        read("[\"x\", { minus = 3 }, { minus = \"z\" }]", "{ minus = \"pitch\" }").unwrap();
    assert_eq!(flight.position.values()[0].to_array(), [1.0, -2.0, -3.0]);
    let euler = flight.attitude.values()[0].euler();
    assert!((euler.pitch + 0.2).abs() < 1e-12 && (euler.yaw - 0.3).abs() < 1e-12);
    for pitch in ["{ plus = \"pitch\" }", "{ minus = \"pitch\", unit = \"deg\" }"] {
        let refused = read("[\"x\", \"y\", \"z\"]", pitch).unwrap_err().to_string();
        assert!(refused.contains("minus"), "{refused}");
    }
}
