//! Finds the columns of each quantity by their names.

use super::{Group, Named, Proposal};
use crate::import::mapping::unit_word::UNDERSCORE;

/// Names of three axes.
const XYZ: [&[&str]; 3] = [&["x", "y", "z"], &["0", "1", "2"], &["1", "2", "3"]];
/// Axes that point north, east and down.
const NED: &[&str] = &["n", "e", "d"];
/// Words in the names of setpoints; `ctrltarget`, `controller` and `posctl` are a Crazyflie's.
const SETPOINT_WORDS: [&str; 10] = [
    "setpoint",
    "sp",
    "desired",
    "des",
    "target",
    "ref",
    "reference",
    "ctrltarget",
    "controller",
    "posctl",
];

/// The columns of an attitude.
pub(super) enum AttitudeColumns {
    Matrix(Group),
    Quaternion(Group),
    Euler(Group),
}

/// The columns of each quantity, as far as the table has them.
pub(super) struct Found {
    pub time: Option<Group>,
    pub position: Option<Group>,
    /// Whether the position's names say north, east, down.
    pub is_ned: bool,
    pub velocity: Option<Group>,
    pub attitude: Option<AttitudeColumns>,
    pub body_rate: Option<Group>,
    pub force: Option<Group>,
    pub motors: Option<Group>,
    pub rotor_speed: Option<Group>,
    pub voltage: Option<Group>,
}

impl Proposal<'_> {
    /// Finds the columns of each quantity, and marks them as used.
    pub(super) fn search(&mut self) -> Found {
        let time = self
            .find(&["t", "time", "timestamp", "stamp", "time_boot", "sec", "seconds"], &[&[""]]);
        let time = time.or_else(|| {
            let at = self.names.iter().position(|name| name.words.contains("time"))?;
            Some(self.take(vec![at]))
        });
        let setpoints = self.reserve_setpoints();
        let north = self.find(&["p", "pos", "position", ""], &[NED, &["north", "east", "down"]]);
        let is_ned = north.is_some();
        let matrix = self.find(
            &["rot", "rotation", "matrix", "rotation_matrix", "r"],
            &[
                &["0", "1", "2", "3", "4", "5", "6", "7", "8"],
                &["1", "2", "3", "4", "5", "6", "7", "8", "9"],
                &["11", "12", "13", "21", "22", "23", "31", "32", "33"],
            ],
        );
        let quaternion = self.find(&["r"], &[&["w", "x", "y", "z"]]);
        let quaternion = quaternion.or_else(|| {
            self.find(
                &["q", "q_rs", "quat", "quaternion", "orientation", "rotation", "attitude", "rot"],
                &[&["w", "x", "y", "z"], &["0", "1", "2", "3"], &["1", "2", "3", "4"]],
            )
        });
        let velocity = self.find(
            &["v", "vel", "velocity", "linear_velocity", "twist_linear", "linear", "v_rs_r"],
            &[NED, XYZ[0], XYZ[1]],
        );
        let velocity = velocity.or_else(|| self.find(&[""], &[&["xdot", "ydot", "zdot"]]));
        let body_rate = self.find(
            &[
                "w",
                "omega",
                "gyro",
                "gyr",
                "rate",
                "body_rate",
                "angular_velocity",
                "angular",
                "gyro_rad",
                "ang_vel",
                "w_rs_s",
            ],
            &XYZ,
        );
        let body_rate = body_rate.or_else(|| self.find(&[""], &[&["p", "q", "r"]]));
        let force = self.find(
            &[
                "acc",
                "a",
                "accel",
                "acceleration",
                "linear_acceleration",
                "accelerometer",
                "f",
                "specific_force",
                "imu_acc",
                "a_rs_s",
            ],
            &XYZ,
        );
        let position = north.or_else(|| {
            let stems = [
                "p",
                "pos",
                "position",
                "translation",
                "pose_position",
                "t",
                "trans",
                "p_rs_r",
                "stateestimate",
                "",
            ];
            self.find(&stems, &XYZ[..1])
        });
        let position = position.or_else(|| self.find_body());
        let attitude =
            matrix.map(AttitudeColumns::Matrix).or(quaternion.map(AttitudeColumns::Quaternion));
        let attitude = attitude.or_else(|| {
            let euler = self.find(
                &["stateestimate", "stabilizer", "", "att", "attitude", "euler", "rpy"],
                &[&["roll", "pitch", "yaw"], &["phi", "theta", "psi"], &["r", "p", "ya"]],
            );
            euler.map(AttitudeColumns::Euler)
        });
        // Commands of motors have such names too.
        setpoints.iter().for_each(|at| self.used[*at] = false);
        let four: [&[&str]; 2] = [&["1", "2", "3", "4"], &["0", "1", "2", "3"]];
        let rotor_speed =
            self.find(&["rpm", "erpm", "rotor_speed", "motor_speed", "rotor", "motor_rpm"], &four);
        let rotor_speed = rotor_speed.or_else(|| self.find(&["r"], &four[..1]));
        let motors = self.find(
            &[
                "m", "motor", "motors", "u", "pwm", "output", "outputs", "cmd", "throttle",
                "thrust", "esc", "control",
            ],
            &four,
        );
        let voltage = self.find(
            &[
                "vbat",
                "voltage",
                "battery_voltage",
                "bat_voltage",
                "batt_v",
                "battery",
                "v_bat",
                "volt",
            ],
            &[&[""]],
        );
        Found {
            time,
            position,
            is_ned,
            velocity,
            attitude,
            body_rate,
            force,
            motors,
            rotor_speed,
            voltage,
        }
    }

    /// Finds the columns of the first stem and axes that all exist and are not yet used, and marks
    /// them as used.
    fn find(&mut self, stems: &[&str], axes: &[&[&str]]) -> Option<Group> {
        for axes in axes {
            for stem in stems {
                let of = |axis: &str| {
                    let forms = match *stem {
                        "" => vec![axis.to_owned()],
                        stem => vec![format!("{stem}{axis}"), format!("{stem}_{axis}")],
                    };
                    // The bias of a sensor is not what the sensor measures.
                    let is_bias = |name: &Named| {
                        ["b_w_", "b_a_"].iter().any(|start| name.words.starts_with(start))
                            || name.words.split(UNDERSCORE).any(|word| word == "bias")
                    };
                    let is_free = |at: &usize| !self.used[*at] && !is_bias(&self.names[*at]);
                    let exact = |at: &usize| forms.contains(&self.names[*at].words);
                    let ends = |at: &usize| forms.iter().any(|form| self.names[*at].is(form));
                    let all = 0..self.names.len();
                    all.clone().filter(is_free).find(exact).or(all.filter(is_free).find(ends))
                };
                let at: Option<Vec<usize>> = axes.iter().map(|axis| of(axis)).collect();
                if let Some(at) = at {
                    return Some(self.take(at));
                }
            }
        }
        None
    }

    /// Finds columns x, y, z of which only the first has the body's name before it, as in Qualisys'
    /// exports.
    fn find_body(&mut self) -> Option<Group> {
        let words = |at: usize| self.names.get(at).map_or("", |name| name.words.as_str());
        let is_first =
            |at: &usize| words(*at).ends_with("_x") && words(at + 1) == "y" && words(at + 2) == "z";
        let is_free = |at: &usize| (*at..at + 3).all(|at| !self.used[at]);
        let first =
            (0..self.names.len().saturating_sub(2)).find(|at| is_first(at) && is_free(at))?;
        Some(self.take(vec![first, first + 1, first + 2]))
    }

    /// Marks the columns of setpoints as used, so that none is taken for a measurement. Returns
    /// them.
    fn reserve_setpoints(&mut self) -> Vec<usize> {
        let is_setpoint =
            |name: &Named| name.words.split(UNDERSCORE).any(|word| SETPOINT_WORDS.contains(&word));
        let all = 0..self.names.len();
        let setpoints: Vec<usize> =
            all.filter(|at| !self.used[*at] && is_setpoint(&self.names[*at])).collect();
        setpoints.iter().for_each(|at| self.used[*at] = true);
        setpoints
    }

    fn take(&mut self, at: Vec<usize>) -> Group {
        at.iter().for_each(|at| self.used[*at] = true);
        let unit = at.first().and_then(|first| self.names[*first].unit);
        Group { at, unit }
    }
}
