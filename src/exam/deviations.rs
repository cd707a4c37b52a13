//! The vehicle behind a builder's file: each number is off by its measurement error, and a drag
//! acts that the builder did not measure.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use vehicle::effects::{EffectId, EffectSet, ParameterValue, RotorDrag, RotorLoss, Slots};
use vehicle::foreign::Foreign;
use vehicle::{ROTORS, VehicleParams};

use super::draw::{Draw, rounded};
use super::tolerances::Tolerances;

/// Values of an effect's parameters, by name.
pub type Parameters = BTreeMap<String, ParameterValue>;

/// Least delay of a command, s.
const DELAY_LEAST_S: f64 = 0.001;
/// Typical drag divided by the mass, 1/s, and the range of shares of it that a file may lack.
const DRAG_TYPICAL: f64 = 0.3;
const DRAG: [f64; 2] = [0.2, 0.5];
/// Range of the drag along the thrust, as a share of that across.
const DRAG_ALONG: [f64; 2] = [0.2, 0.6];
/// Share of drags that follow another law, and the speed at which they equal the linear one, m/s.
const OTHER_DRAG: f64 = 0.3;
const DRAG_AT_M_S: f64 = 3.0;

/// A difference of the vehicle from its file, in terms of the catalogue.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Deviation {
    /// Id of the effect that describes it.
    pub id: String,
    /// The vehicle's values.
    pub parameters: Parameters,
    /// The file's values.
    pub neutral: Parameters,
    /// Values that no log distinguishes from the vehicle's.
    pub alternatives: Vec<Parameters>,
    /// Its distance from the file in claimed standard deviations.
    pub tolerances: Option<f64>,
}

/// A drag that the file lacks.
#[derive(Clone, Debug, PartialEq)]
enum Drag {
    /// The catalogue's rotor_drag.
    Rotor(RotorDrag),
    /// A drag under another law.
    Other(Foreign),
}

/// Differences of a vehicle from its file without any effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Deviations {
    /// The standard deviations that the differences were drawn with.
    pub tolerances: Tolerances,
    /// Differences from the file's numbers, as shares.
    thrust_common: f64,
    thrust_each: [f64; ROTORS],
    mass: f64,
    inertia: [f64; 3],
    drag_torque: f64,
    lag: f64,
    /// Position of the centre of mass, m.
    centre_m: [f64; 2],
    delay_s: f64,
    trim_rad: [f64; 2],
    pose_s: f64,
    drag: Option<Drag>,
}

impl Deviations {
    /// A vehicle that matches its file.
    pub fn none(file: &VehicleParams) -> Self {
        Self {
            tolerances: Tolerances::typical(file),
            thrust_common: 0.0,
            thrust_each: [0.0; ROTORS],
            mass: 0.0,
            inertia: [0.0; 3],
            drag_torque: 0.0,
            lag: 0.0,
            centre_m: [0.0; 2],
            delay_s: 0.0,
            trim_rad: [0.0; 2],
            pose_s: 0.0,
            drag: None,
        }
    }

    /// Draws the differences of a careful builder's file. A drag acts where the file models none.
    pub fn draw(draw: &mut Draw, file: &VehicleParams) -> Self {
        let tolerances = Tolerances::draw(draw, file);
        let has_drag = file.modelled_effects.contains(EffectId::RotorDrag)
            || file.modelled_effects.contains(EffectId::ParasiticDrag);
        let mut off = |sigma: f64| rounded(sigma * draw.normal());
        let drawn = Self {
            tolerances,
            thrust_common: off(tolerances.thrust_common),
            thrust_each: std::array::from_fn(|_| off(tolerances.thrust_each)),
            mass: off(tolerances.mass),
            inertia: std::array::from_fn(|_| off(tolerances.inertia)),
            drag_torque: off(tolerances.drag_torque),
            lag: off(tolerances.lag),
            centre_m: std::array::from_fn(|_| off(tolerances.centre_m)),
            delay_s: off(tolerances.delay_s).max(DELAY_LEAST_S - file.command_delay_s),
            trim_rad: std::array::from_fn(|_| off(tolerances.trim_rad)),
            pose_s: 0.0,
            drag: None,
        };
        let pose_s = rounded(draw.within(tolerances.pose_s));
        let drag = (!has_drag).then(|| Drag::draw(draw, file));
        Self { pose_s, drag, ..drawn }
    }

    /// Draws another vehicle of the type. The errors of measurements common to the type stay, and
    /// those of each build are drawn again.
    pub fn of_sibling(&self, draw: &mut Draw) -> Self {
        let sigma = self.tolerances;
        let mut off = |sigma: f64| rounded(sigma * draw.normal());
        Self {
            thrust_each: std::array::from_fn(|_| off(sigma.thrust_each)),
            mass: off(sigma.mass),
            inertia: std::array::from_fn(|_| off(sigma.inertia)),
            centre_m: std::array::from_fn(|_| off(sigma.centre_m)),
            trim_rad: std::array::from_fn(|_| off(sigma.trim_rad)),
            ..self.clone()
        }
    }

    /// Removes the differences that `effects`, or another law for one of `causes`, replace: the
    /// numbers of an effect are the vehicle's, whatever the builder measured.
    pub fn beside(&self, effects: &EffectSet, causes: &[EffectId], rotor: Option<usize>) -> Self {
        let is = |id| effects.contains(id) || causes.contains(&id);
        let mut left = self.clone();
        let rotor = effects.get::<RotorLoss>().map(|loss| loss.rotor).or(rotor);
        if let Some(each) = rotor.and_then(|rotor| left.thrust_each.get_mut(rotor)) {
            *each = 0.0;
        }
        if is(EffectId::ThrustScale) || is(EffectId::Mass) {
            // Logs do not distinguish the two.
            (left.thrust_common, left.mass) = (0.0, 0.0);
        }
        if is(EffectId::Inertia) {
            left.inertia = [0.0; 3];
        }
        if is(EffectId::YawTorque) {
            left.drag_torque = 0.0;
        }
        if is(EffectId::MotorLag) {
            left.lag = 0.0;
        }
        if is(EffectId::ComOffset) {
            left.centre_m = [0.0; 2];
        }
        if is(EffectId::CommandDelay) {
            left.delay_s = 0.0;
        }
        if is(EffectId::AttitudeTrim) {
            left.trim_rad = [0.0; 2];
        }
        if is(EffectId::EstimatorLatency) {
            left.pose_s = 0.0;
        }
        if is(EffectId::RotorDrag) || is(EffectId::ParasiticDrag) {
            left.drag = None;
        }
        left
    }

    /// The vehicle: the file with the right numbers.
    pub fn body(&self, file: &VehicleParams) -> VehicleParams {
        let mut body = file.clone();
        body.mass *= 1.0 + self.mass;
        for (moment, off) in body.inertia.iter_mut().zip(self.inertia) {
            *moment *= 1.0 + off;
        }
        for (rotor, each) in body.rotors.iter_mut().zip(self.thrust_each) {
            rotor.thrust_max_n *= (1.0 + self.thrust_common) * (1.0 + each);
            rotor.drag_torque_per_thrust_m *= 1.0 + self.drag_torque;
            rotor.position_m[0] -= self.centre_m[0];
            rotor.position_m[1] -= self.centre_m[1];
        }
        body.motor_time_constant_s *= 1.0 + self.lag;
        body.command_delay_s += self.delay_s;
        body
    }

    /// Differences for which the file has no number: trim, age of the pose, drag.
    pub fn effects(&self) -> EffectSet {
        let mut effects = EffectSet::new();
        let [roll, pitch] = self.trim_rad;
        // The catalogue accepts values of this size.
        if self.trim_rad != [0.0; 2] {
            let _ = effects.insert(EffectId::AttitudeTrim, slots(&[roll, pitch]));
        }
        if self.pose_s > 0.0 {
            let _ = effects.insert(EffectId::EstimatorLatency, slots(&[self.pose_s]));
        }
        if let Some(Drag::Rotor(RotorDrag { d_xy, d_z })) = self.drag {
            let _ = effects.insert(EffectId::RotorDrag, slots(&[d_xy, d_z]));
        }
        effects
    }

    /// A drag under a law outside the catalogue.
    pub fn foreign(&self) -> Option<&Foreign> {
        match &self.drag {
            Some(Drag::Other(foreign)) => Some(foreign),
            _ => None,
        }
    }

    /// All differences, in terms of the catalogue.
    pub fn listed(&self, file: &VehicleParams) -> Vec<Deviation> {
        let sigma = &self.tolerances;
        let number = |name: &str, value: f64| {
            Parameters::from([(name.to_owned(), ParameterValue::Number(rounded(value)))])
        };
        let numbers = |pairs: &[(&str, f64)]| -> Parameters {
            pairs.iter().flat_map(|(name, value)| number(name, *value)).collect()
        };
        let each = self.thrust_each.map(|off| 1.0 + off);
        let mean_each = each.iter().sum::<f64>() / ROTORS as f64;
        let common = 1.0 + self.thrust_common;
        let thrust = common * mean_each;
        let mass = 1.0 + self.mass;
        let mut all = Vec::new();
        let mut list = |id: EffectId, parameters, neutral, alternatives, off: Option<f64>| {
            all.push(Deviation {
                id: id.name().to_owned(),
                parameters,
                neutral,
                alternatives,
                tolerances: off.map(rounded),
            });
        };
        if self.thrust_common != 0.0 || self.mass != 0.0 {
            let scale = |value| number("scale", value);
            let off = Some(self.thrust_common.abs() / sigma.thrust_common);
            let others = [thrust, common / mass, thrust / mass, 1.0 / mass].map(scale).to_vec();
            list(EffectId::ThrustScale, scale(common), scale(1.0), others, off);
        }
        if self.inertia != [0.0; 3] {
            let scale = |values: [f64; 3]| {
                let values = ParameterValue::Vector(values.map(rounded).to_vec());
                Parameters::from([("scale".to_owned(), values)])
            };
            let is = self.inertia.map(|off| 1.0 + off);
            let [x, y, z] = is.map(|scale| scale / thrust);
            let turned = [x, y, z / (1.0 + self.drag_torque)];
            let off = self.inertia.iter().fold(0.0, |most: f64, off| most.max(off.abs()));
            let others = vec![scale([x, y, z]), scale(turned)];
            list(EffectId::Inertia, scale(is), scale([1.0; 3]), others, Some(off / sigma.inertia));
        }
        let lean = self.lean(file);
        if self.centre_m != [0.0; 2] || lean != [0.0; 2] {
            let at = |[x, y]: [f64; 2]| numbers(&[("x_m", x), ("y_m", y)]);
            let [x, y] = self.centre_m;
            let off = x.hypot(y) / sigma.centre_m;
            let others = vec![at([x - lean[0], y - lean[1]])];
            list(EffectId::ComOffset, at([x, y]), at([0.0; 2]), others, Some(off));
        }
        if self.drag_torque != 0.0 {
            let scale = |value| number("scale", value);
            let is = 1.0 + self.drag_torque;
            let others = vec![scale(is * thrust), scale(is * thrust / (1.0 + self.inertia[2]))];
            let off = self.drag_torque.abs() / sigma.drag_torque;
            list(EffectId::YawTorque, scale(is), scale(1.0), others, Some(off));
        }
        let lag = file.motor_time_constant_s;
        if self.lag != 0.0 && lag > 0.0 {
            let tau = |value| number("tau_s", value);
            let off = self.lag.abs() / sigma.lag;
            let is = tau(lag * (1.0 + self.lag));
            list(EffectId::MotorLag, is, tau(lag), Vec::new(), Some(off));
        }
        if self.delay_s != 0.0 {
            let delay = |value| number("delay_s", value);
            let stated = file.command_delay_s;
            let off = self.delay_s.abs() / sigma.delay_s;
            let is = delay(stated + self.delay_s);
            list(EffectId::CommandDelay, is, delay(stated), Vec::new(), Some(off));
        }
        if self.trim_rad != [0.0; 2] {
            let trim = |[roll, pitch]: [f64; 2]| {
                numbers(&[("roll_rad", roll), ("pitch_rad", pitch), ("yaw_rad", 0.0)])
            };
            let off = self.trim_rad[0].hypot(self.trim_rad[1]) / sigma.trim_rad;
            let (is, neutral) = (trim(self.trim_rad), trim([0.0; 2]));
            list(EffectId::AttitudeTrim, is, neutral, Vec::new(), Some(off));
        }
        if self.pose_s != 0.0 {
            let latency = |value| number("latency_s", value);
            let off = self.pose_s / sigma.pose_s[1];
            let (is, neutral) = (latency(self.pose_s), latency(0.0));
            list(EffectId::EstimatorLatency, is, neutral, Vec::new(), Some(off));
        }
        for (rotor, scale) in each.into_iter().enumerate().filter(|(_, scale)| *scale != 1.0) {
            let at = |value| numbers(&[("rotor", rotor as f64), ("scale", value)]);
            let others = (mean_each * ROTORS as f64 - scale) / (ROTORS - 1) as f64;
            let others = vec![at(scale * common), at(scale / mean_each), at(scale / others)];
            let off = (scale - 1.0).abs() / sigma.thrust_each;
            list(EffectId::RotorLoss, at(scale), at(1.0), others, Some(off));
        }
        match &self.drag {
            None => {}
            Some(Drag::Rotor(RotorDrag { d_xy, d_z })) => {
                let drag = |xy, z| numbers(&[("d_xy", xy), ("d_z", z)]);
                list(EffectId::RotorDrag, drag(*d_xy, *d_z), drag(0.0, 0.0), Vec::new(), None);
            }
            Some(Drag::Other(foreign)) => {
                // The drag of each law of the catalogue that is equal at an ordinary speed.
                let linear = match foreign {
                    Foreign::DragPower { coefficient, exponent } => {
                        coefficient * DRAG_AT_M_S.powf(exponent - 1.0)
                    }
                    Foreign::DragPlates { quadratic: [x, y, _] } => 0.5 * (x + y) * DRAG_AT_M_S,
                    _ => 0.0,
                };
                let drag = |value: f64| numbers(&[("d_xy", value), ("d_z", 0.0)]);
                list(EffectId::RotorDrag, drag(linear), drag(0.0), Vec::new(), None);
                let area = |value: f64| number("cda_m2", value);
                let is = area(2.0 * linear / (file.air_density * DRAG_AT_M_S));
                list(EffectId::ParasiticDrag, is, area(0.0), Vec::new(), None);
            }
        }
        all
    }

    /// The centre of thrust of unequal rotors, m.
    fn lean(&self, file: &VehicleParams) -> [f64; 2] {
        let each = self.thrust_each.map(|off| 1.0 + off);
        let total: f64 = each.iter().sum();
        std::array::from_fn(|axis| {
            let moments = file.rotors.iter().zip(each).map(|(r, s)| s * r.position_m[axis]);
            moments.sum::<f64>() / total
        })
    }
}

impl Drag {
    fn draw(draw: &mut Draw, file: &VehicleParams) -> Self {
        let linear = draw.within(DRAG) * DRAG_TYPICAL * file.mass;
        if !draw.chance(OTHER_DRAG) {
            let d_z = rounded(linear * draw.within(DRAG_ALONG));
            return Self::Rotor(RotorDrag { d_xy: rounded(linear), d_z });
        }
        Self::Other(if draw.chance(0.5) {
            let exponent = rounded(draw.within([1.2, 1.8]));
            let coefficient = rounded(linear * DRAG_AT_M_S.powf(1.0 - exponent));
            Foreign::DragPower { coefficient, exponent }
        } else {
            let quadratic = linear / DRAG_AT_M_S;
            let shares = [1.0, draw.within([0.8, 1.2]), draw.within([1.0, 2.0])];
            Foreign::DragPlates { quadratic: shares.map(|share| rounded(share * quadratic)) }
        })
    }
}

/// Slots that start with these values.
fn slots(values: &[f64]) -> Slots {
    let mut slots = Slots::default();
    for (slot, value) in slots.iter_mut().zip(values) {
        *slot = *value;
    }
    slots
}

#[cfg(test)]
mod tests {
    use vehicle::effects::{AttitudeTrim, EstimatorLatency};

    use super::super::airframe;
    use super::*;

    /// Files with their drawn differences.
    fn drawn() -> impl Iterator<Item = (VehicleParams, Deviations)> {
        (0..400).map(|number| {
            let mut draw = Draw::new(8, number);
            let file = airframe::vehicle(&mut draw, "quad");
            let deviations = Deviations::draw(&mut draw, &file);
            (file, deviations)
        })
    }

    /// Root mean square of values in standard deviations, which should be 1.
    fn spread(values: impl Iterator<Item = f64>) -> f64 {
        let (sum, count) = values.fold((0.0, 0.0), |(sum, n), z| (sum + z * z, n + 1.0));
        (sum / f64::max(count, 1.0)).sqrt()
    }

    #[test]
    fn deviations_match_the_claimed_tolerances() {
        let all: Vec<_> = drawn().collect();
        let bodies: Vec<_> = all.iter().map(|(file, off)| (file, off, off.body(file))).collect();
        // With 400 draws the standard error of a spread is 3.5 %.
        let is_one = |spread: f64| (0.86..1.14).contains(&spread);
        type Z = fn(&VehicleParams, &Tolerances, &VehicleParams) -> f64;
        let numbers: [(&str, Z); 5] = [
            ("mass", |file, sigma, body| (body.mass / file.mass - 1.0) / sigma.mass),
            ("inertia", |file, sigma, body| {
                (body.inertia[1] / file.inertia[1] - 1.0) / sigma.inertia
            }),
            ("drag torque", |file, sigma, body| {
                let [is, stated] = [body, file].map(|v| v.rotors[2].drag_torque_per_thrust_m);
                (is / stated - 1.0) / sigma.drag_torque
            }),
            ("centre", |file, sigma, body| {
                (file.rotors[0].position_m[0] - body.rotors[0].position_m[0]) / sigma.centre_m
            }),
            ("thrust", |file, sigma, body| {
                let off = body.rotors[3].thrust_max_n / file.rotors[3].thrust_max_n - 1.0;
                off / sigma.thrust_common.hypot(sigma.thrust_each)
            }),
        ];
        for (name, z) in numbers {
            let spread =
                spread(bodies.iter().map(|(file, off, body)| z(file, &off.tolerances, body)));
            assert!(is_one(spread), "{name}: {spread}");
        }
        let trims = all.iter().map(|(_, off)| {
            off.effects()
                .get::<AttitudeTrim>()
                .map_or(0.0, |trim| trim.trim.roll / off.tolerances.trim_rad)
        });
        assert!(is_one(spread(trims)));
        let lags = all.iter().filter(|(file, _)| file.motor_time_constant_s > 0.0);
        let lags = lags.map(|(file, off)| {
            (off.body(file).motor_time_constant_s / file.motor_time_constant_s - 1.0)
                / off.tolerances.lag
        });
        assert!(is_one(spread(lags)));
    }

    #[test]
    fn unmodelled_drag_and_pose_latency_are_drawn() {
        let mut other_laws = 0;
        for (file, off) in drawn() {
            let effects = off.effects();
            let latency = effects.get::<EstimatorLatency>().expect("late").latency_s;
            assert!((off.tolerances.pose_s[0]..=off.tolerances.pose_s[1]).contains(&latency));
            let shares = DRAG.map(|share| share * DRAG_TYPICAL * 0.99..share * DRAG_TYPICAL * 1.01);
            match effects.get::<RotorDrag>() {
                Some(drag) => {
                    let per_mass = drag.d_xy / file.mass;
                    assert!(per_mass > shares[0].start && per_mass < shares[1].end, "{per_mass}");
                    assert!(off.foreign().is_none());
                }
                None => {
                    assert!(off.foreign().is_some());
                    other_laws += 1;
                }
            }
        }
        assert!((80..160).contains(&other_laws), "{other_laws}");
    }

    #[test]
    fn claimed_tolerances_match_the_draw_and_round_trip() {
        let (file, off) = drawn().next().expect("one");
        let file = VehicleParams { provenance: off.tolerances.provenance(), ..file };
        let json = serde_json::to_string(&file).expect("JSON");
        let read = VehicleParams::from_json_str(&json).expect("a vehicle file");
        let claim = |key: &str, name: &str| read.provenance[key][name].as_f64();
        assert_eq!(claim("inertia", "sigma_share"), Some(off.tolerances.inertia));
        assert_eq!(
            claim("rotors.thrust_max_N", "sigma_share_each"),
            Some(off.tolerances.thrust_each)
        );
        assert_eq!(claim("rotors.position_m", "sigma_com_m"), Some(off.tolerances.centre_m));
    }

    #[test]
    fn effect_replaces_the_deviation_of_its_number() {
        let (file, off) = drawn().next().expect("one");
        let mut effects = EffectSet::new();
        effects.insert_argument("inertia:scale=[1.4,1.4,1.4]").expect("an effect");
        let body = off.beside(&effects, &[], None).body(&file);
        assert_eq!(body.inertia, file.inertia);
        assert_ne!(body.mass, file.mass);
        let listed = off.beside(&effects, &[], None).listed(&file);
        assert!(listed.iter().all(|deviation| deviation.id != "inertia"));
        assert_eq!(off.listed(&file).iter().filter(|d| d.id == "inertia").count(), 1);
    }
}
