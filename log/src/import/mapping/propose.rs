//! Proposes a mapping file from the names of a table's columns and its first rows.

use super::super::table::Sheet;
use super::unit_word::{self, UNDERSCORE};

mod crazyflie;
mod values;

/// Lengths beyond this are none in m: rooms and fields are smaller.
const ROOM_M: f64 = 100.0;
/// Body rates beyond this are none in rad/s.
const FAST_RAD_S: f64 = 35.0;
/// Larger motor outputs are no pulses in us but numbers of 16 bits, as Crazyflies log them.
const PULSE_MAX_US: f64 = 3000.0;
const XYZ: [&[&str]; 3] = [&["x", "y", "z"], &["0", "1", "2"], &["1", "2", "3"]];
const NED: &[&str] = &["n", "e", "d"];
/// Words in the names of what was wanted, `ctrltarget`, `controller` and `posctl` on a Crazyflie.
const WANTED: [&str; 10] = [
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

/// A column's name in lower case with joined words, and its unit if the name has one.
#[derive(Debug)]
struct Named {
    words: String,
    unit: Option<&'static str>,
}

impl Named {
    /// By the name itself, else with the unit that stands below it.
    fn new(name: &str, below: Option<&str>) -> Self {
        let (words, unit) = unit_word::split(&unit_word::words(name));
        Self { words, unit: unit.or_else(|| unit_word::of_cell(below?)) }
    }

    /// Whether the name equals `words` or ends with them as whole words.
    fn is(&self, words: &str) -> bool {
        self.words.strip_suffix(words).is_some_and(|before| {
            before.is_empty() || before.ends_with(UNDERSCORE) && words.len() > 1
        })
    }
}

/// A group of columns.
struct Group {
    at: Vec<usize>,
    unit: Option<&'static str>,
}

struct Proposal<'a> {
    sheet: &'a Sheet,
    names: Vec<Named>,
    used: Vec<bool>,
    text: String,
}

/// The text of a mapping file for a table. It marks guesses that the names do not confirm with
/// `CHECK`, and comments out what it cannot find.
pub(in crate::import) fn propose(sheet: &Sheet) -> String {
    let named = |(at, name): (usize, &String)| {
        let below = sheet.units.get(at).map(String::as_str);
        Named::new(&format!("{} {name}", sheet.group(at)), below)
    };
    let mut names: Vec<Named> = sheet.names.iter().enumerate().map(named).collect();
    crazyflie::add_units(&mut names);
    let used = vec![false; names.len()];
    let mut proposal = Proposal { sheet, names, used, text: String::new() };
    proposal.write();
    proposal.text
}

impl Proposal<'_> {
    fn line(&mut self, text: &str) {
        self.text.push_str(text);
        self.text.push('\n');
    }

    /// The columns with the first of these names that all exist and are not yet used.
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

    /// Columns x, y, z of which only the first has the name of the body before it, as in Qualisys'
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

    /// Marks columns of what was wanted as used, which are none of what was measured. Returns them.
    fn set_wanted_aside(&mut self) -> Vec<usize> {
        let is_wanted =
            |name: &Named| name.words.split(UNDERSCORE).any(|word| WANTED.contains(&word));
        let all = 0..self.names.len();
        let wanted: Vec<usize> =
            all.filter(|at| !self.used[*at] && is_wanted(&self.names[*at])).collect();
        wanted.iter().for_each(|at| self.used[*at] = true);
        wanted
    }

    fn take(&mut self, at: Vec<usize>) -> Group {
        at.iter().for_each(|at| self.used[*at] = true);
        let unit = at.first().and_then(|first| self.names[*first].unit);
        Group { at, unit }
    }

    /// A column as the mapping identifies it: by number if its name is not unique.
    fn column(&self, at: usize) -> String {
        let name = &self.sheet.names[at];
        let count = self.sheet.names.iter().filter(|known| *known == name).count();
        if count == 1 {
            toml::Value::String(name.clone()).to_string()
        } else {
            (at + 1).to_string()
        }
    }

    fn columns(&self, group: &Group) -> String {
        let column = |at: &usize| match crazyflie::is_opposite(&self.names[*at]) {
            true => format!("{{ minus = {} }}", self.column(*at)),
            false => self.column(*at),
        };
        let columns: Vec<String> = group.at.iter().map(column).collect();
        format!("[{}]", columns.join(", "))
    }

    /// A line `unit = ...`: the unit in the names if it is one of `units`, else the first, marked
    /// for checking.
    fn unit(&mut self, stated: Option<&'static str>, units: &[&str]) {
        match stated.filter(|stated| units.contains(stated)) {
            Some(unit) => self.line(&format!("unit = {unit:?}")),
            None => {
                let others: Vec<String> = units.iter().map(|unit| format!("{unit:?}")).collect();
                let first = units.first().copied().unwrap_or_default();
                self.line(&format!("unit = {first:?}  # CHECK: {}", others.join(", ")));
            }
        }
    }

    fn write(&mut self) {
        let time = self
            .find(&["t", "time", "timestamp", "stamp", "time_boot", "sec", "seconds"], &[&[""]]);
        let time = time.or_else(|| {
            let at = self.names.iter().position(|name| name.words.contains("time"))?;
            Some(self.take(vec![at]))
        });
        let wanted = self.set_wanted_aside();
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
        let rate = self.find(
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
        let rate = rate.or_else(|| self.find(&[""], &[&["p", "q", "r"]]));
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
        let euler = match quaternion.is_some() || matrix.is_some() {
            true => None,
            false => self.find(
                &["stateestimate", "stabilizer", "", "att", "attitude", "euler", "rpy"],
                &[&["roll", "pitch", "yaw"], &["phi", "theta", "psi"], &["r", "p", "ya"]],
            ),
        };
        // Commands of motors have such names too.
        wanted.iter().for_each(|at| self.used[*at] = false);
        let four: [&[&str]; 2] = [&["1", "2", "3", "4"], &["0", "1", "2", "3"]];
        let speed =
            self.find(&["rpm", "erpm", "rotor_speed", "motor_speed", "rotor", "motor_rpm"], &four);
        let speed = speed.or_else(|| self.find(&["r"], &four[..1]));
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

        self.line(
            "# Proposed from the names of the table's columns. Check every line marked CHECK: the",
        );
        self.line(
            "# table does not show it; config/mappings/motion-capture.toml explains every key.",
        );
        if self.sheet.separator != b',' {
            let separator = char::from(self.sheet.separator).to_string();
            let separator = toml::Value::String(separator).to_string();
            self.line(&format!("separator = {separator}"));
        }
        let has_attitude = matrix.is_some() || quaternion.is_some() || euler.is_some();
        let is_any_axis = position.is_some() || velocity.is_some() || has_attitude;
        if is_any_axis {
            match is_ned {
                true => self.line("world_frame = \"ned\""),
                false => self.line("world_frame = \"nwu\"  # CHECK: \"ned\", \"enu\", \"nwu\" or where x, y and z point, as [\"north\", \"up\", \"east\"]"),
            }
        }
        if has_attitude || rate.is_some() || force.is_some() {
            let body = if is_ned { "frd" } else { "flu" };
            self.line(&format!("body_frame = {body:?}  # CHECK: \"frd\", \"flu\" or where x, y and z point, as [\"front\", \"up\", \"right\"]"));
        }
        self.line("\n[time]");
        match &time {
            Some(group) => {
                let at = group.at.first().copied().unwrap_or(0);
                let column = self.column(at);
                self.line(&format!("column = {column}"));
                let unit = group.unit.filter(|unit| ["s", "ms", "us", "ns"].contains(unit));
                match unit.or_else(|| self.is_date(at).then_some("iso8601")) {
                    Some(unit) => self.line(&format!("unit = {unit:?}")),
                    None => {
                        let (unit, step) = self.time_unit(at);
                        self.line(&format!("unit = {unit:?}  # CHECK: \"s\", \"ms\", \"us\" or \"ns\"; it rises by {step} a row"));
                    }
                }
            }
            None => self.line(
                "rate_hz = 100.0  # CHECK: no column looks like a time; the rate of the rows",
            ),
        }
        if let Some(group) = &position {
            let columns = self.columns(group);
            self.line(&format!("\n[position]\ncolumns = {columns}"));
            let units = match self.largest(group) > ROOM_M {
                true => ["mm", "cm", "m"],
                false => ["m", "cm", "mm"],
            };
            self.unit(group.unit, &units);
        }
        if let Some(group) = &velocity {
            let columns = self.columns(group);
            self.line(&format!("\n[velocity]\ncolumns = {columns}"));
            self.unit(group.unit, &["m/s", "cm/s", "mm/s"]);
            self.line("axes = \"world\"  # CHECK: \"world\" or \"body\"");
        }
        if let Some(group) = &matrix {
            let columns = self.columns(group);
            self.line(&format!("\n[attitude]\nmatrix = {columns}  # CHECK: row by row"));
            // Qualisys writes its matrices column by column: read row by row, they are inverse.
            let first = group.at.first().map_or("", |at| self.sheet.names[*at].as_str());
            self.line(match first {
                "Rot[0]" => "rotates = \"world_to_body\"  # CHECK: or \"body_to_world\"; Qualisys writes column by column",
                _ => "rotates = \"body_to_world\"  # CHECK: or \"world_to_body\"",
            });
        } else if let Some(group) = &quaternion {
            let columns = self.columns(group);
            let is_named = group.at.first().is_some_and(|at| self.names[*at].words.ends_with('w'));
            self.line(&format!("\n[attitude]\nquaternion = {columns}"));
            self.line(match is_named {
                true => "order = \"wxyz\"",
                false => {
                    "order = \"wxyz\"  # CHECK: \"wxyz\" or \"xyzw\", the order of these columns"
                }
            });
            self.line("rotates = \"body_to_world\"  # CHECK: or \"world_to_body\"");
        } else if let Some(group) = &euler {
            let columns = self.columns(group);
            let unit = group.unit.or_else(|| self.angle_unit(group));
            self.line(&format!("\n[attitude]\neuler = {columns}"));
            if group.at.iter().any(|at| crazyflie::is_opposite(&self.names[*at])) {
                self.line("# A Crazyflie's pitch rises with the nose, in axes with y to the left.");
            }
            self.unit(unit, &["rad", "deg"]);
        }
        if let Some(group) = &rate {
            let columns = self.columns(group);
            self.line(&format!("\n[body_rate]\ncolumns = {columns}"));
            let unit = group.unit.or((self.largest(group) > FAST_RAD_S).then_some("deg/s"));
            self.unit(unit, &["rad/s", "deg/s"]);
            self.line("axes = \"body\"  # CHECK: \"body\" or \"world\"");
        }
        if let Some(group) = &force {
            let columns = self.columns(group);
            self.line(&format!("\n[specific_force]\ncolumns = {columns}"));
            let is_in_g = (self.mean_size(group) - 1.0).abs() < 0.2;
            self.unit(group.unit.or(is_in_g.then_some("g")), &["m/s2", "g"]);
            // An acceleration is turned by an attitude.
            let meaning = if has_attitude { self.force_meaning(group) } else { "specific_force" };
            self.line(&format!("meaning = {meaning:?}  # CHECK: \"specific_force\" (1 g upwards at rest) or \"acceleration\" (nothing at rest)"));
            let is_of_world = |at: &usize| crazyflie::is_of_world(&self.names[*at]);
            let axes = if group.at.iter().all(is_of_world) { "world" } else { "body" };
            self.line(&format!("axes = {axes:?}  # CHECK: \"body\" or \"world\""));
        }
        if let Some(group) = &motors {
            let columns = self.columns(group);
            self.line(&format!("\n[motors]\ncolumns = {columns}  # CHECK: in the order of the vehicle file's rotors"));
            let most = self.largest(group);
            match most > 2.0 {
                true => self.line(&format!("meaning = \"pwm\"  # CHECK: or \"thrust_N\", \"rotor_speed\"\nrange = [{}]  # CHECK: at no and at full thrust; the largest here is {most}", if most > PULSE_MAX_US { "0.0, 65535.0" } else { "1000.0, 2000.0" })),
                false => self.line("meaning = \"thrust_fraction\"  # CHECK: or \"thrust_N\", \"pwm\", \"rotor_speed\""),
            }
        }
        if let Some(group) = &speed {
            let columns = self.columns(group);
            self.line(&format!("\n[rotor_speed]\ncolumns = {columns}  # CHECK: in the order of the vehicle file's rotors"));
            let is_rpm = group
                .at
                .first()
                .is_some_and(|at| self.sheet.names[*at].to_lowercase().contains("rpm"));
            self.unit(if is_rpm { Some("rpm") } else { group.unit }, &["rpm", "rad/s"]);
        }
        if let Some(group) = &voltage {
            let column = self.column(group.at.first().copied().unwrap_or(0));
            self.line(&format!("\n[voltage]\ncolumn = {column}"));
            self.unit(group.unit, &["V", "mV"]);
        }
        let found = [("position", position.is_some()), ("attitude", has_attitude)];
        for (what, _) in found.into_iter().filter(|(_, is_found)| !is_found) {
            self.line(&format!("\n# EDIT: no columns look like [{what}]"));
        }
        let free: Vec<&str> = (self.sheet.names.iter().zip(&self.used))
            .filter(|(name, used)| !**used && !name.is_empty())
            .map(|(name, _)| name.as_str())
            .collect();
        if !free.is_empty() {
            let free = free.join(", ").replace(char::is_control, " ");
            self.line(&format!("\n# Not used: {free}"));
        }
    }
}
