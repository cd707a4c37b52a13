//! A draft as the text of a vehicle file, with comments.

use std::fmt::Write as _;

use toml::Value;

use super::body::tidy;
use super::{AIR_DENSITY, Draft, GRAVITY, Given, Tolerance, Wanting};

impl Draft {
    /// The text of the vehicle file, with the meaning and source of each number. Unknown keys are
    /// comments that say how to measure them.
    pub fn to_toml(&self) -> String {
        let mut page = Page::default();
        self.head(&mut page);
        self.top(&mut page);
        self.rotors(&mut page);
        self.onboard_loop(&mut page);
        self.pack_and_effects(&mut page);
        self.provenance(&mut page);
        page.0
    }

    fn head(&self, page: &mut Page) {
        page.comment(&format!(
            "Vehicle file, written by `downwash vehicle init` from {}.",
            self.source
        ));
        page.comment("Lengths in m, SI throughout; body axes front, right, down.");
        let mut list = |title: &str, wanting: Vec<Wanting>| {
            if wanting.is_empty() {
                return;
            }
            page.line("#");
            page.comment(title);
            for Wanting { key, what, how } in wanting {
                page.comment(&format!("- {key}, {what}: {how}."));
            }
        };
        list("MISSING, without which the file cannot be used:", self.missing());
        list("ESTIMATED, worth measuring:", self.estimated());
        page.line("");
        page.line(&format!("name = {}", quoted(&self.name)));
        if let Some(autopilot) = self.autopilot {
            page.line(&format!("autopilot = {}", quoted(autopilot.name())));
        }
    }

    fn top(&self, page: &mut Page) {
        page.entry("mass", "kg", self.mass.as_ref().map(number).as_ref());
        page.entry("inertia", "kg m^2", self.inertia.as_ref().map(numbers).as_ref());
        page.entry("motor_time_constant_s", "s", Some(&number(&self.motor_lag)));
        page.entry("command_delay_s", "s", Some(&number(&self.command_delay)));
        page.entry(
            "hover_thrust",
            "fraction of full thrust",
            self.hover_thrust.as_ref().map(number).as_ref(),
        );
        page.line(&format!("gravity = {GRAVITY}"));
        page.line(&format!("air_density = {AIR_DENSITY:?} # near the ground, kg/m^3"));
        page.entry("rotor_radius_m", "m", self.rotor_radius.as_ref().map(number).as_ref());
        if let Some(drag) = &self.linear_drag {
            page.entry("linear_drag_N_per_m_s", "N per m/s", Some(&number(drag)));
        }
        if let Some(damping) = &self.angular_damping {
            let each = damping.as_form([damping.value; 3]);
            page.entry("angular_damping_Nms", "N m s", Some(&numbers(&each)));
        }
    }

    fn rotors(&self, page: &mut Page) {
        page.line("");
        page.comment(
            "The rotors, in the order of the autopilot's motors. spin is 1 where the rotor turns",
        );
        page.comment(
            "anticlockwise, seen from above, and its drag turns the body to the right, else -1.",
        );
        for motor in 0..4 {
            page.line("");
            let place = self.positions.as_ref().map(|given| given.value[motor]);
            page.line(&format!("[[rotors]] # motor {}: {}", motor + 1, self.layout[motor]));
            page.short("position_m", place.map(|place| array(&place)));
            page.short("spin", Some(self.spins.value[motor].to_string()));
            page.short("thrust_max_N", self.thrust_max.as_ref().map(|t| float(t.value)));
            let ratio = self.torque_ratio.as_ref().map(|ratio| float(ratio.value));
            page.short("drag_torque_per_thrust_m", ratio);
        }
    }

    fn onboard_loop(&self, page: &mut Page) {
        page.line("");
        let Some(cascade) = &self.cascade else {
            let why = match (self.autopilot, self.cascade_lacks.as_slice()) {
                (None, _) => "it is unknown without an autopilot's parameters".to_owned(),
                (Some(_), lacks) => format!("it needs {}", lacks.join(", ")),
            };
            page.comment(&format!(
                "The on-board loop (attitude_cascade) is left out: {why}. Feedback then assumes a \
                 slow one, and `plan` and `fly --replan` refuse the file."
            ));
            return;
        };
        page.comment("The on-board loop: proportional on the attitude, PID on the body rate.");
        page.comment(&format!("From {}.", cascade.from));
        page.line("[attitude_cascade]");
        // Serialised from the struct, with the numbers as formatted here.
        if let Ok(Value::Table(table)) = Value::try_from(cascade.value) {
            for (key, value) in table {
                page.line(&format!("{key} = {value}"));
            }
        }
    }

    fn pack_and_effects(&self, page: &mut Page) {
        let pack = &self.battery;
        page.line("");
        page.comment(&format!("The pack: {}.", pack.from));
        page.line("[battery]");
        page.line(&format!("cells = {}", pack.value.cells));
        page.line(&format!("full_V = {}", float(pack.value.full_v)));
        page.line(&format!("nominal_V = {}", float(pack.value.nominal_v)));
        page.line("");
        page.line("[modelled_effects]");
        if let Some(curve) = &self.thrust_curve {
            page.line("");
            page.comment(&format!("Thrust over output: {}.", curve.from));
            page.line("[modelled_effects.thrust_curve]");
            page.line(&format!("a = {}", float(curve.value)));
        }
        if let Some(drag) = &self.linear_drag {
            page.line("");
            page.comment("The nearest effect to linear_drag_N_per_m_s, which acts in its place.");
            page.line("[modelled_effects.rotor_drag]");
            page.line(&format!("d_xy = {}", float(drag.value)));
            page.line(&format!("d_z = {}", float(drag.value)));
        }
    }

    fn provenance(&self, page: &mut Page) {
        page.line("");
        page.comment("Where the numbers come from, and one standard deviation where it is known.");
        page.line("[provenance]");
        page.source("mass", self.mass.as_ref());
        page.source("inertia", self.inertia.as_ref());
        page.source("rotors.position_m", self.positions.as_ref());
        page.source("rotors.spin", Some(&self.spins));
        page.source("rotors.thrust_max_N", self.thrust_max.as_ref());
        page.source("rotors.drag_torque_per_thrust_m", self.torque_ratio.as_ref());
        page.source("rotor_radius_m", self.rotor_radius.as_ref());
        page.source("motor_time_constant_s", Some(&self.motor_lag));
        page.source("command_delay_s", Some(&self.command_delay));
        page.source("hover_thrust", self.hover_thrust.as_ref());
        page.source("attitude_cascade", self.cascade.as_ref());
        page.source("battery", Some(&self.battery));
        page.source("linear_drag_N_per_m_s", self.linear_drag.as_ref());
        page.source("angular_damping_Nms", self.angular_damping.as_ref());
        page.source("thrust_curve", self.thrust_curve.as_ref());
    }
}

impl<T> Given<T> {
    /// The same number in another form.
    fn as_form<U>(&self, value: U) -> Given<U> {
        Given {
            value,
            from: self.from.clone(),
            tolerance: self.tolerance,
            is_estimate: self.is_estimate,
        }
    }
}

/// The text written so far.
#[derive(Default)]
struct Page(String);

/// Width of a comment, characters.
const WIDTH: usize = 98;

impl Page {
    fn line(&mut self, line: &str) {
        self.0.push_str(line);
        self.0.push('\n');
    }

    /// Writes a comment, broken into lines.
    fn comment(&mut self, text: &str) {
        let mut line = String::from("#");
        for word in text.split_whitespace() {
            if line.len() + 1 + word.len() > WIDTH {
                self.line(&line);
                line = String::from("#  ");
            }
            line.push(' ');
            line.push_str(word);
        }
        self.line(&line);
    }

    /// Writes a key with the source of its value.
    fn entry(&mut self, key: &'static str, unit: &str, given: Option<&Given<String>>) {
        match given {
            Some(given) => {
                let mark = if given.is_estimate { "ESTIMATED " } else { "" };
                let within = given.tolerance.map_or(String::new(), |tolerance| match tolerance {
                    Tolerance::Share(share) => format!(", +-{:.0} %", 100.0 * share),
                    Tolerance::Seconds(s) => format!(", +-{s} s"),
                });
                self.comment(&format!("{key}, {unit}: {mark}{}{within}", given.from));
                self.line(&format!("{key} = {}", given.value));
            }
            None => {
                let how = super::wanting(key)
                    .map_or(String::new(), |wanting| format!(" {}: {}", wanting.what, wanting.how));
                self.comment(&format!("{key} = ? MISSING{how}"));
            }
        }
    }

    /// Writes a key without its source.
    fn short(&mut self, key: &str, value: Option<String>) {
        match value {
            Some(value) => self.line(&format!("{key} = {value}")),
            None => self.line(&format!("# {key} = ? MISSING, see above")),
        }
    }

    fn source<T>(&mut self, key: &str, given: Option<&Given<T>>) {
        let Some(given) = given else { return };
        let mut table = format!("{{ from = {}", quoted(&given.from));
        let _ = match given.tolerance {
            Some(Tolerance::Share(share)) => write!(table, ", sigma_share = {share:?}"),
            Some(Tolerance::Seconds(s)) => write!(table, ", sigma_s = {s:?}"),
            None => Ok(()),
        };
        let key = if key.contains('.') { quoted(key) } else { key.to_owned() };
        self.line(&format!("{key} = {table} }}"));
    }
}

fn number(given: &Given<f64>) -> Given<String> {
    given.as_form(float(given.value))
}

fn numbers(given: &Given<[f64; 3]>) -> Given<String> {
    given.as_form(array(&given.value))
}

/// A float in TOML syntax.
fn float(value: f64) -> String {
    Value::Float(tidy(value)).to_string()
}

fn array(values: &[f64]) -> String {
    let values: Vec<String> = values.iter().map(|value| float(*value)).collect();
    format!("[{}]", values.join(", "))
}

fn quoted(text: &str) -> String {
    Value::String(text.to_owned()).to_string()
}
