//! Proposes a mapping file from the names of a table's columns and its first rows.

use super::super::table::Sheet;
use super::unit_word::{self, UNDERSCORE};

mod columns;
mod crazyflie;
mod values;

use columns::{AttitudeColumns, Found};

/// Larger positions are not in m: rooms and fields are smaller.
const ROOM_M: f64 = 100.0;
/// Larger body rates are not in rad/s.
const FAST_RAD_S: f64 = 35.0;
/// Larger motor outputs are not pulse widths in us but 16-bit numbers, as Crazyflies log them.
const PULSE_MAX_US: f64 = 3000.0;

/// A column's name in lower case with joined words, and its unit if the name has one.
#[derive(Debug)]
struct Named {
    words: String,
    unit: Option<&'static str>,
}

impl Named {
    /// Splits a name into words and unit; `below` is the cell below it, which may have the unit.
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
        let found = self.search();
        self.write_head();
        self.write_frames(&found);
        self.write_time(found.time.as_ref());
        if let Some(group) = &found.position {
            self.write_position(group);
        }
        if let Some(group) = &found.velocity {
            self.write_velocity(group);
        }
        if let Some(attitude) = &found.attitude {
            self.write_attitude(attitude);
        }
        if let Some(group) = &found.body_rate {
            self.write_body_rate(group);
        }
        if let Some(group) = &found.force {
            self.write_force(group, found.attitude.is_some());
        }
        if let Some(group) = &found.motors {
            self.write_motors(group);
        }
        if let Some(group) = &found.rotor_speed {
            self.write_rotor_speed(group);
        }
        if let Some(group) = &found.voltage {
            self.write_voltage(group);
        }
        self.write_rest(&found);
    }

    fn write_head(&mut self) {
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
    }

    fn write_frames(&mut self, found: &Found) {
        let has_attitude = found.attitude.is_some();
        if found.position.is_some() || found.velocity.is_some() || has_attitude {
            match found.is_ned {
                true => self.line("world_frame = \"ned\""),
                false => self.line("world_frame = \"nwu\"  # CHECK: \"ned\", \"enu\", \"nwu\" or where x, y and z point, as [\"north\", \"up\", \"east\"]"),
            }
        }
        if has_attitude || found.body_rate.is_some() || found.force.is_some() {
            let body = if found.is_ned { "frd" } else { "flu" };
            self.line(&format!("body_frame = {body:?}  # CHECK: \"frd\", \"flu\" or where x, y and z point, as [\"front\", \"up\", \"right\"]"));
        }
    }

    fn write_time(&mut self, time: Option<&Group>) {
        self.line("\n[time]");
        match time {
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
    }

    fn write_position(&mut self, group: &Group) {
        let columns = self.columns(group);
        self.line(&format!("\n[position]\ncolumns = {columns}"));
        let units = match self.largest(group) > ROOM_M {
            true => ["mm", "cm", "m"],
            false => ["m", "cm", "mm"],
        };
        self.unit(group.unit, &units);
    }

    fn write_velocity(&mut self, group: &Group) {
        let columns = self.columns(group);
        self.line(&format!("\n[velocity]\ncolumns = {columns}"));
        self.unit(group.unit, &["m/s", "cm/s", "mm/s"]);
        self.line("axes = \"world\"  # CHECK: \"world\" or \"body\"");
    }

    fn write_attitude(&mut self, attitude: &AttitudeColumns) {
        match attitude {
            AttitudeColumns::Matrix(group) => {
                let columns = self.columns(group);
                self.line(&format!("\n[attitude]\nmatrix = {columns}  # CHECK: row by row"));
                // Qualisys writes its matrices column by column: read row by row, they are inverse.
                let first = group.at.first().map_or("", |at| self.sheet.names[*at].as_str());
                self.line(match first {
                    "Rot[0]" => {
                        "rotates = \"world_to_body\"  # CHECK: or \"body_to_world\"; Qualisys writes \
                         column by column"
                    }
                    _ => "rotates = \"body_to_world\"  # CHECK: or \"world_to_body\"",
                });
            }
            AttitudeColumns::Quaternion(group) => {
                let columns = self.columns(group);
                let is_named =
                    group.at.first().is_some_and(|at| self.names[*at].words.ends_with('w'));
                self.line(&format!("\n[attitude]\nquaternion = {columns}"));
                self.line(match is_named {
                    true => "order = \"wxyz\"",
                    false => {
                        "order = \"wxyz\"  # CHECK: \"wxyz\" or \"xyzw\", the order of these \
                         columns"
                    }
                });
                self.line("rotates = \"body_to_world\"  # CHECK: or \"world_to_body\"");
            }
            AttitudeColumns::Euler(group) => {
                let columns = self.columns(group);
                let unit = group.unit.or_else(|| self.angle_unit(group));
                self.line(&format!("\n[attitude]\neuler = {columns}"));
                if group.at.iter().any(|at| crazyflie::is_opposite(&self.names[*at])) {
                    self.line(
                        "# A Crazyflie's pitch rises with the nose, in axes with y to the left.",
                    );
                }
                self.unit(unit, &["rad", "deg"]);
            }
        }
    }

    fn write_body_rate(&mut self, group: &Group) {
        let columns = self.columns(group);
        self.line(&format!("\n[body_rate]\ncolumns = {columns}"));
        let unit = group.unit.or((self.largest(group) > FAST_RAD_S).then_some("deg/s"));
        self.unit(unit, &["rad/s", "deg/s"]);
        self.line("axes = \"body\"  # CHECK: \"body\" or \"world\"");
    }

    /// Only an attitude turns an acceleration into a specific force.
    fn write_force(&mut self, group: &Group, has_attitude: bool) {
        let columns = self.columns(group);
        self.line(&format!("\n[specific_force]\ncolumns = {columns}"));
        let is_in_g = (self.mean_size(group) - 1.0).abs() < 0.2;
        self.unit(group.unit.or(is_in_g.then_some("g")), &["m/s2", "g"]);
        let meaning = if has_attitude { self.force_meaning(group) } else { "specific_force" };
        self.line(&format!("meaning = {meaning:?}  # CHECK: \"specific_force\" (1 g upwards at rest) or \"acceleration\" (nothing at rest)"));
        let is_of_world = |at: &usize| crazyflie::is_of_world(&self.names[*at]);
        let axes = if group.at.iter().all(is_of_world) { "world" } else { "body" };
        self.line(&format!("axes = {axes:?}  # CHECK: \"body\" or \"world\""));
    }

    fn write_motors(&mut self, group: &Group) {
        let columns = self.columns(group);
        self.line(&format!(
            "\n[motors]\ncolumns = {columns}  # CHECK: in the order of the vehicle file's rotors"
        ));
        let most = self.largest(group);
        match most > 2.0 {
            true => self.line(&format!("meaning = \"pwm\"  # CHECK: or \"thrust_N\", \"rotor_speed\"\nrange = [{}]  # CHECK: at no and at full thrust; the largest here is {most}", if most > PULSE_MAX_US { "0.0, 65535.0" } else { "1000.0, 2000.0" })),
            false => self.line("meaning = \"thrust_fraction\"  # CHECK: or \"thrust_N\", \"pwm\", \"rotor_speed\""),
        }
    }

    fn write_rotor_speed(&mut self, group: &Group) {
        let columns = self.columns(group);
        self.line(&format!("\n[rotor_speed]\ncolumns = {columns}  # CHECK: in the order of the vehicle file's rotors"));
        let is_rpm =
            group.at.first().is_some_and(|at| self.sheet.names[*at].to_lowercase().contains("rpm"));
        self.unit(if is_rpm { Some("rpm") } else { group.unit }, &["rpm", "rad/s"]);
    }

    fn write_voltage(&mut self, group: &Group) {
        let column = self.column(group.at.first().copied().unwrap_or(0));
        self.line(&format!("\n[voltage]\ncolumn = {column}"));
        self.unit(group.unit, &["V", "mV"]);
    }

    /// Writes what was not found, and the columns without a use.
    fn write_rest(&mut self, found: &Found) {
        let parts =
            [("position", found.position.is_some()), ("attitude", found.attitude.is_some())];
        for (what, _) in parts.into_iter().filter(|(_, is_found)| !is_found) {
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
