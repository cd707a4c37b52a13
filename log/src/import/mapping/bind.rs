//! Binds a mapping to the columns of a table: finds columns and reports missing keys.

use super::axes::{AttitudeTurn, BodyFrame, WorldFrame};
use super::contradiction;
use super::heading::Heading;
use super::row::{
    AttitudeReader, Columns, ForceReader, MotorReader, Outputs, Rotation, RowReader, TimeReader,
    VectorReader,
};
use super::unit_word;
use super::{
    AccelerationUnit, AngleUnit, AttitudeMap, Axes, Column, ForceMap, ForceMeaning, LengthText,
    LengthUnit, Mapping, MotorMap, MotorMeaning, Place, PositionMap, RateMap, RateUnit, Rotates,
    RotorUnit, SpeedMap, SpeedUnit, TimeMap, TimeUnit, VelocityMap, VoltageMap, VoltageUnit,
};
use crate::import::{RPM, STANDARD_GRAVITY};

/// What a mapping states of the time.
const TIME: &str = "[time] with column and unit, or with rate_hz";

/// Error message for a missing key.
fn missing(field: &str, expected: &str) -> String {
    format!("{field} is missing: write {field} = {expected}")
}

/// Finds columns and records which are used.
struct Binder<'a> {
    heading: Heading<'a>,
    used: Vec<bool>,
    /// Notes on columns that the mapping identifies by number.
    notes: Vec<String>,
    world: Option<WorldFrame>,
    body: Option<BodyFrame>,
}

impl Binder<'_> {
    fn column(&mut self, field: &str, column: &Place) -> Result<usize, String> {
        match self.heading.called(column).as_slice() {
            [at] => {
                self.used[*at] = true;
                if let (Place::Number(_), Some(_)) = (column, self.heading.names) {
                    let found = self.heading.pointed_out(*at);
                    self.notes.push(format!("{field}: column {found}"));
                }
                Ok(*at)
            }
            [] => {
                Err(format!("{field}: the table has no column {column}; {}", self.heading.offers()))
            }
            several => Err(format!(
                "{field}: {}; write the number of one, or a list of words above it and its name",
                self.heading.listed(column, several)
            )),
        }
    }

    /// Columns of a quantity whose unit has this factor to SI.
    fn columns<const N: usize>(
        &mut self,
        field: &str,
        names: &[Column; N],
        factor: f64,
    ) -> Result<Columns<N>, String> {
        let columns = self.raw(field, names, factor)?;
        for at in columns.at {
            contradiction::unit(&self.heading, field, at, factor)?;
        }
        Ok(columns)
    }

    /// Columns without a unit to compare with the table's labels.
    fn raw<const N: usize>(
        &mut self,
        field: &str,
        names: &[Column; N],
        factor: f64,
    ) -> Result<Columns<N>, String> {
        let mut at = [0; N];
        let mut factors = [factor; N];
        for ((at, factor), name) in at.iter_mut().zip(&mut factors).zip(names) {
            *at = self.column(field, &name.place)?;
            *factor *= name.sign();
        }
        Ok(Columns { at, factors })
    }

    /// Whether a line of units is below the names: one of the cells below the columns in use is a
    /// unit. Notes those that are no known units.
    fn units(&mut self) -> bool {
        let Some(units) = self.heading.units else { return false };
        let used = units.iter().enumerate().filter(|(at, _)| self.used.get(*at) == Some(&true));
        let words = used.filter(|(_, cell)| !unit_word::is_none(cell));
        let (known, unknown): (Vec<_>, Vec<_>) =
            words.partition(|(_, cell)| unit_word::of_cell(cell).is_some());
        if known.is_empty() {
            return false;
        }
        let unknown = unknown.iter().map(|(at, cell)| {
            let column = self.heading.pointed_out(*at);
            format!("the unit {cell:?} of column {column} is unknown and was not compared")
        });
        self.notes.extend(unknown);
        true
    }

    fn world(&self) -> Result<WorldFrame, String> {
        self.world.ok_or_else(|| {
            missing(
                "world_frame",
                r#""ned", "enu", "nwu" or where its axes point, as ["north", "up", "east"]"#,
            )
        })
    }

    fn body(&self) -> Result<BodyFrame, String> {
        self.body.ok_or_else(|| {
            missing(
                "body_frame",
                r#""frd", "flu" or where its axes point, as ["front", "up", "right"]"#,
            )
        })
    }

    fn axes(&self, field: &str, axes: Option<Axes>) -> Result<Axes, String> {
        let field = format!("{field}.axes");
        let axes = axes.ok_or_else(|| missing(&field, r#""world" or "body""#))?;
        match axes {
            Axes::World => self.world().map(drop)?,
            Axes::Body => self.body().map(drop)?,
        }
        Ok(axes)
    }

    fn attitude(&mut self, field: &str, map: &AttitudeMap) -> Result<AttitudeReader, String> {
        let forms = [map.quaternion.is_some(), map.euler.is_some(), map.matrix.is_some()];
        if forms.iter().filter(|given| **given).count() != 1 {
            return Err(format!(
                "{field}: expected one of quaternion, euler and matrix, each a list of columns"
            ));
        }
        let refuse = |is_given: bool, key: &str| match is_given {
            true => Err(format!("{field}.{key} has no meaning here; take it out")),
            false => Ok(()),
        };
        refuse(map.order.is_some() && map.quaternion.is_none(), "order")?;
        refuse(map.unit.is_some() && map.euler.is_none(), "unit")?;
        refuse(map.rotates.is_some() && map.euler.is_some(), "rotates")?;
        let (rotation, is_inverse) = if let Some(names) = &map.euler {
            let expected = r#""rad" or "deg" (yaw, then pitch, then roll turn the world into the body; columns: roll, pitch, yaw)"#;
            let factor =
                match map.unit.ok_or_else(|| missing(&format!("{field}.unit"), expected))? {
                    AngleUnit::Rad => 1.0,
                    AngleUnit::Deg => 1f64.to_radians(),
                };
            (Rotation::Euler(self.columns(field, names, factor)?), false)
        } else {
            let expected = r#""body_to_world" (v_world = R v_body) or "world_to_body""#;
            let rotates =
                map.rotates.ok_or_else(|| missing(&format!("{field}.rotates"), expected))?;
            let is_inverse = matches!(rotates, Rotates::WorldToBody);
            let rotation = match (&map.quaternion, &map.matrix) {
                (Some(names), _) => {
                    let expected = r#""wxyz" or "xyzw", in the order of the columns"#;
                    let order =
                        map.order.ok_or_else(|| missing(&format!("{field}.order"), expected))?;
                    let columns = self.raw(field, names, 1.0)?;
                    contradiction::order(&self.heading, field, columns.at, order)?;
                    Rotation::Quaternion(columns, order)
                }
                (None, Some(names)) => Rotation::Matrix(self.raw(field, names, 1.0)?),
                (None, None) => return Err(format!("{field}: no columns")),
            };
            (rotation, is_inverse)
        };
        let turn = AttitudeTurn::new(self.world()?, self.body()?).ok_or_else(|| {
            format!(
                "{field}: of world_frame and body_frame one is right-handed and one left-handed: \
                 no rotation relates them"
            )
        })?;
        Ok(AttitudeReader { rotation, is_inverse, turn })
    }

    fn rate(&mut self, field: &str, map: &RateMap) -> Result<VectorReader, String> {
        let expected = r#""rad/s" or "deg/s""#;
        let factor = match map.unit.ok_or_else(|| missing(&format!("{field}.unit"), expected))? {
            RateUnit::Radians => 1.0,
            RateUnit::Degrees => 1f64.to_radians(),
        };
        let axes = self.axes(field, map.axes)?;
        self.body()?;
        Ok(VectorReader { columns: self.columns(field, &map.columns, factor)?, axes })
    }

    fn time(&mut self, map: &TimeMap) -> Result<TimeReader, String> {
        match (&map.column, map.rate_hz, map.unit) {
            (Some(column), None, Some(TimeUnit::Iso8601)) => {
                let columns = std::array::from_ref(column);
                Ok(TimeReader::Date(self.raw("time.column", columns, 1.0)?))
            }
            (Some(column), None, Some(unit)) => {
                let factor = match unit {
                    TimeUnit::S | TimeUnit::Iso8601 => 1.0,
                    TimeUnit::Ms => 1e-3,
                    TimeUnit::Us => 1e-6,
                    TimeUnit::Ns => 1e-9,
                };
                let columns = std::array::from_ref(column);
                Ok(TimeReader::Column(self.columns("time.column", columns, factor)?))
            }
            (Some(_), None, None) => {
                Err(missing("time.unit", r#""s", "ms", "us", "ns" or "iso8601""#))
            }
            (None, Some(rate), None) if rate.is_finite() && rate > 0.0 => {
                Ok(TimeReader::Rate(rate))
            }
            _ => Err(format!("expected {TIME}, and a rate above 0")),
        }
    }

    fn position(&mut self, map: &PositionMap) -> Result<Columns<3>, String> {
        self.world()?;
        let unit = match &map.unit {
            Some(LengthText::Unit(unit)) => *unit,
            Some(LengthText::Above { above }) => {
                let unit_text = self.heading.after(above);
                unit_text.and_then(LengthUnit::named).ok_or_else(|| {
                    let found = unit_text.map_or("no such cell".to_owned(), |s| format!("{s:?}"));
                    format!(
                        "position.unit: expected a unit after {above:?}, found {found}: write it"
                    )
                })?
            }
            None => return Err(missing("position.unit", r#""m", "cm" or "mm""#)),
        };
        self.columns("position.columns", &map.columns, unit.in_m())
    }

    fn velocity(&mut self, map: &VelocityMap) -> Result<VectorReader, String> {
        let expected = r#""m/s", "cm/s" or "mm/s""#;
        let factor = match map.unit.ok_or_else(|| missing("velocity.unit", expected))? {
            SpeedUnit::Metres => 1.0,
            SpeedUnit::Centimetres => 0.01,
            SpeedUnit::Millimetres => 1e-3,
        };
        let axes = self.axes("velocity", map.axes)?;
        Ok(VectorReader { columns: self.columns("velocity.columns", &map.columns, factor)?, axes })
    }

    fn specific_force(&mut self, map: &ForceMap) -> Result<ForceReader, String> {
        let expected = r#""m/s2" or "g""#;
        let factor = match map.unit.ok_or_else(|| missing("specific_force.unit", expected))? {
            AccelerationUnit::MetresPerSecondSquared => 1.0,
            AccelerationUnit::Gravity => STANDARD_GRAVITY,
        };
        let expected = r#""specific_force" (what an accelerometer shows: 1 g upwards at rest) or "acceleration" (nothing at rest)"#;
        let meaning = map.meaning.ok_or_else(|| missing("specific_force.meaning", expected))?;
        let gravity_mps2 = map.gravity_mps2.unwrap_or(STANDARD_GRAVITY);
        if !(gravity_mps2.is_finite() && gravity_mps2 > 0.0) {
            return Err("specific_force.gravity_mps2: expected a number above 0".to_owned());
        }
        let axes = self.axes("specific_force", map.axes)?;
        let columns = self.columns("specific_force.columns", &map.columns, factor)?;
        Ok(ForceReader { vector: VectorReader { columns, axes }, meaning, gravity_mps2 })
    }

    fn motors(&mut self, map: &MotorMap) -> Result<Motors, String> {
        let expected = r#""thrust_fraction", "thrust_N", "pwm" or "rotor_speed""#;
        let meaning = map.meaning.ok_or_else(|| missing("motors.meaning", expected))?;
        refuse_stray(map, meaning)?;
        let mut reader = MotorReader {
            columns: self.raw("motors.columns", &map.columns, 1.0)?,
            range: [0.0, 1.0],
            polynomial: None,
        };
        let (outputs, speed_factor) = match meaning {
            MotorMeaning::ThrustFraction => (Outputs::Fraction, None),
            MotorMeaning::ThrustN => (Outputs::Newton, None),
            MotorMeaning::Pwm => {
                if map.range.is_none() && map.polynomial_n.is_none() {
                    return Err("motors: the thrust of a PWM value is missing: write range = \
                                [value of no thrust, value of full thrust] for a thrust that is \
                                proportional between them, or polynomial_N = [c0, c1, c2] for a \
                                thrust of c0 + c1 x + c2 x^2 in N (x being the PWM value, or its \
                                place in the range where that is given too)"
                        .into());
                }
                if let Some([zero, one]) = map.range {
                    if !(zero.is_finite() && one.is_finite() && zero != one) {
                        return Err("motors.range: expected two different numbers".into());
                    }
                    reader.range = [zero, one];
                }
                reader.polynomial = map.polynomial_n.clone();
                match &reader.polynomial {
                    Some(c) if c.is_empty() || c.iter().any(|c| !c.is_finite()) => {
                        return Err("motors.polynomial_N: expected numbers".into());
                    }
                    Some(_) => (Outputs::Newton, None),
                    None => (Outputs::Fraction, None),
                }
            }
            MotorMeaning::RotorSpeed => {
                let unit = map.unit.ok_or_else(|| missing("motors.unit", r#""rad/s" or "rpm""#))?;
                let coefficient = map.thrust_coefficient_n_s2.filter(|k| k.is_finite() && *k > 0.0);
                let coefficient = coefficient.ok_or_else(|| {
                    let expected = "a number above 0: thrust in N over the square of rad/s";
                    missing("motors.thrust_coefficient_N_s2", expected)
                })?;
                let factor = rad_per_s(unit);
                reader.polynomial = Some(vec![0.0, 0.0, coefficient * factor * factor]);
                (Outputs::Newton, Some(factor))
            }
        };
        Ok(Motors { reader, outputs, speed_factor })
    }

    fn rotor_speed(&mut self, map: &SpeedMap) -> Result<Columns<4>, String> {
        let expected = r#""rad/s" or "rpm""#;
        let unit = map.unit.ok_or_else(|| missing("rotor_speed.unit", expected))?;
        self.columns("rotor_speed.columns", &map.columns, rad_per_s(unit))
    }

    fn voltage(&mut self, map: &VoltageMap) -> Result<Columns<1>, String> {
        let factor = match map.unit.ok_or_else(|| missing("voltage.unit", r#""V" or "mV""#))? {
            VoltageUnit::V => 1.0,
            VoltageUnit::Millivolt => 1e-3,
        };
        self.columns("voltage.column", std::array::from_ref(&map.column), factor)
    }
}

/// Refuses keys of `[motors]` that have no meaning for columns of this meaning.
fn refuse_stray(map: &MotorMap, meaning: MotorMeaning) -> Result<(), String> {
    let is_pwm = matches!(meaning, MotorMeaning::Pwm);
    let is_speed = matches!(meaning, MotorMeaning::RotorSpeed);
    let stray = [
        (map.range.is_some() && !is_pwm, "range", "pwm"),
        (map.polynomial_n.is_some() && !is_pwm, "polynomial_N", "pwm"),
        (map.unit.is_some() && !is_speed, "unit", "rotor_speed"),
        (
            map.thrust_coefficient_n_s2.is_some() && !is_speed,
            "thrust_coefficient_N_s2",
            "rotor_speed",
        ),
    ];
    match stray.into_iter().find(|(is_stray, ..)| *is_stray) {
        Some((_, key, meaning)) => {
            Err(format!("motors.{key} belongs to meaning = {meaning:?}; take one of them out"))
        }
        None => Ok(()),
    }
}

/// The motor commands of a table.
struct Motors {
    reader: MotorReader,
    outputs: Outputs,
    /// If the columns are rotor speeds, their factor to rad/s.
    speed_factor: Option<f64>,
}

fn rad_per_s(unit: RotorUnit) -> f64 {
    match unit {
        RotorUnit::Radians => 1.0,
        RotorUnit::Rpm => RPM,
    }
}

impl RowReader {
    /// Binds the mapping to a table's columns; the error says what is missing and what to write.
    pub fn new(mapping: &Mapping, heading: Heading<'_>) -> Result<Self, String> {
        let used = vec![false; heading.width];
        let mut binder = Binder {
            heading,
            used,
            notes: Vec::new(),
            world: mapping.world_frame,
            body: mapping.body_frame,
        };
        if let Some(Column { place, .. }) = &mapping.single {
            let found = heading.called(place);
            if found.len() > 1 {
                return Err(format!(
                    "single: {}; copy the mapping, give the columns of one, and take single out",
                    heading.listed(place, &found)
                ));
            }
        }
        let time = mapping.time.as_ref().ok_or_else(|| format!("expected {TIME}"))?;
        let time = binder.time(time)?;
        let position = mapping.position.as_ref().map(|map| binder.position(map)).transpose()?;
        let velocity = mapping.velocity.as_ref().map(|map| binder.velocity(map)).transpose()?;
        let attitude =
            mapping.attitude.as_ref().map(|map| binder.attitude("attitude", map)).transpose()?;
        let body_rate =
            mapping.body_rate.as_ref().map(|map| binder.rate("body_rate", map)).transpose()?;
        let force = mapping.specific_force.as_ref();
        let specific_force = force.map(|map| binder.specific_force(map)).transpose()?;
        let motors = mapping.motors.as_ref().map(|map| binder.motors(map)).transpose()?;
        let rotor_speed = match (&mapping.rotor_speed, &motors) {
            (Some(map), _) => Some(binder.rotor_speed(map)?),
            (None, Some(Motors { reader, speed_factor: Some(factor), .. })) => {
                let Columns { at, factors } = reader.columns;
                Some(Columns { at, factors: factors.map(|sign| sign * factor) })
            }
            (None, _) => None,
        };
        let voltage = mapping.voltage.as_ref().map(|map| binder.voltage(map)).transpose()?;
        let (mut setpoint_attitude, mut setpoint_rate, mut setpoint_thrust) = (None, None, None);
        if let Some(map) = &mapping.setpoint {
            let of = |attitude: &AttitudeMap| binder.attitude("setpoint.attitude", attitude);
            setpoint_attitude = map.attitude.as_ref().map(of).transpose()?;
            let of = |rate: &RateMap| binder.rate("setpoint.body_rate", rate);
            setpoint_rate = map.body_rate.as_ref().map(of).transpose()?;
            if let Some(name) = &map.thrust_fraction {
                let columns = std::array::from_ref(name);
                setpoint_thrust = Some(binder.raw("setpoint.thrust_fraction", columns, 1.0)?);
            }
        }
        let is_in = |reader: Option<VectorReader>, axes: Axes| {
            reader.is_some_and(|reader| reader.axes == axes)
        };
        let turned = [
            ("velocity.axes = \"body\"", is_in(velocity, Axes::Body)),
            ("body_rate.axes = \"world\"", is_in(body_rate, Axes::World)),
            (
                "specific_force in world axes or without gravity",
                specific_force.is_some_and(|force| {
                    force.vector.axes == Axes::World || force.meaning == ForceMeaning::Acceleration
                }),
            ),
            ("setpoint.body_rate.axes = \"world\"", is_in(setpoint_rate, Axes::World)),
        ];
        if let Some((what, _)) = turned.iter().find(|(_, needs)| *needs && attitude.is_none()) {
            return Err(format!("{what} needs the attitude: write [attitude]"));
        }
        let has_units = binder.units();
        Ok(Self {
            has_units,
            // A missing frame is not needed: everything that needs it has checked it above.
            world: mapping.world_frame.unwrap_or(WorldFrame::NED),
            body: mapping.body_frame.unwrap_or(BodyFrame::FRD),
            time,
            position,
            velocity,
            attitude,
            body_rate,
            specific_force,
            outputs: motors.as_ref().map_or(Outputs::Fraction, |motors| motors.outputs),
            motors: motors.map(|motors| motors.reader),
            rotor_speed,
            voltage,
            setpoint_attitude,
            setpoint_rate,
            setpoint_thrust,
            used: binder.used,
            notes: binder.notes,
        })
    }
}
