//! Plausibility checks on a vehicle file: numbers that are valid alone and may not fit each other.
//!
//! The ranges are wide. They include vehicles from 30 g to 25 kg; a number in the wrong unit, or
//! from another vehicle, mostly falls outside.

use serde::Serialize;

use super::VehicleParams;
use super::validity::LOOP_RATE_MAX_HZ;

mod rotors;

/// Range of full thrust over weight of vehicles that fly well.
const THRUST_TO_WEIGHT: [f64; 2] = [1.3, 12.0];
/// Full thrust over weight below which a vehicle cannot leave the ground.
const LIFTS: f64 = 1.0;
/// Accepted relative deviation of `hover_thrust` from weight over full thrust.
const HOVER_SHARE: f64 = 0.25;
/// Radius of gyration about front and right, over the mean distance of the rotors from the centre.
const GYRATION_TILT: [f64; 2] = [0.18, 0.95];
/// Radius of gyration about down, over the same distance.
const GYRATION_YAW: [f64; 2] = [0.25, 1.3];
/// Distance of the rotors from the centre, m: from what lies in a hand to what lifts people.
const ARM_M: [f64; 2] = [0.01, 5.0];
/// Factor beyond the expected range at which a moment of inertia belongs to no vehicle.
const INERTIA_ABSURD: f64 = 50.0;
/// Units in which moments of inertia are often given, in kg m^2.
const INERTIA_UNITS: [(f64, &str); 5] =
    [(1e-3, "g m^2"), (1e-4, "kg cm^2"), (1e-6, "kg mm^2"), (1e-7, "g cm^2"), (1e-9, "g mm^2")];
/// Units in which arms are often given, in m.
const ARM_UNITS: [(f64, &str); 2] = [(1e-2, "cm"), (1e-3, "mm")];
/// Range of the on-board loop's natural frequency, rad/s.
const LOOP_RAD_S: [f64; 2] = [1.0, 50.0];
/// Range of the on-board loop's damping ratio.
const LOOP_DAMPING: [f64; 2] = [0.3, 4.0];
/// Rate gain over inertia, times lag and delay, above which the rate loop oscillates.
const RATE_LOOP_LAG: f64 = 3.0;
/// Most of `command_delay_s` that the rate loop sees, s. The rest is the link's.
const ONBOARD_DELAY_MAX_S: f64 = 0.01;
/// Voltage of a full cell, V: from nickel-metal hydride to the highest of lithium.
const CELL_FULL_V: [f64; 2] = [1.2, 4.6];
/// The axes' names in messages.
const AXES: [&str; 3] = ["roll", "pitch", "yaw"];

/// How bad a [`Remark`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Doubt {
    /// Few vehicles have such numbers.
    Unlikely,
    /// A vehicle with such numbers cannot fly.
    CannotFly,
}

/// Two or more numbers of a vehicle file that do not fit each other.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Remark {
    /// Severity of the mismatch.
    pub doubt: Doubt,
    /// The field to check first.
    pub field: &'static str,
    /// The value computed from the file.
    pub found: f64,
    /// Smallest and largest expected value.
    pub expected: [f64; 2],
    /// Unit of `found` and `expected`; empty for ratios.
    pub unit: &'static str,
    /// The remark as a sentence.
    pub what: String,
}

impl VehicleParams {
    /// Numbers of this vehicle that do not fit each other, worst first. Assumes a valid file, as
    /// [`VehicleParams::load`] returns it.
    pub fn remarks(&self) -> Vec<Remark> {
        let mut remarks: Vec<Remark> = self.thrust_to_weight().into_iter().collect();
        // If mass or thrust is far off, a comparison with hover_thrust says nothing more.
        let is_light = remarks.iter().all(|remark| remark.doubt != Doubt::CannotFly);
        remarks.extend(self.hover_remark().filter(|_| is_light));
        let arm = self.arm_remark();
        let inertia = self.inertia_remarks();
        // Moments of inertia and rotors are compared with the arm, so a wrong arm explains them too.
        remarks.extend(inertia.into_iter().filter(|_| arm.is_none()));
        remarks.extend(self.rotor_remarks().into_iter().filter(|_| arm.is_none()));
        remarks.extend(arm);
        remarks.extend(self.loop_remarks());
        remarks.extend(self.battery_remark());
        remarks.sort_by_key(|remark| std::cmp::Reverse(remark.doubt));
        remarks
    }

    fn thrust_to_weight(&self) -> Option<Remark> {
        let (full, weight) = (self.thrust_full_n(), self.weight_n());
        let ratio = full / weight;
        let [least, most] = THRUST_TO_WEIGHT;
        if (least..=most).contains(&ratio) {
            return None;
        }
        let lifts = ratio >= LIFTS;
        let grams = 1e3 * ratio;
        let advice = if !lifts && (least..=most).contains(&grams) {
            "; mass is in kg: it looks like grams"
        } else if !lifts {
            "; check mass (kg) and thrust_max_N (N, of one rotor)"
        } else {
            ""
        };
        Some(Remark {
            doubt: if lifts { Doubt::Unlikely } else { Doubt::CannotFly },
            field: "mass",
            found: ratio,
            expected: THRUST_TO_WEIGHT,
            unit: "",
            what: format!(
                "full thrust of {} N is {} times the weight of {} N, expected {least} to {most} \
                 times{advice}",
                brief(full),
                brief(ratio),
                brief(weight)
            ),
        })
    }

    fn hover_remark(&self) -> Option<Remark> {
        let share = self.hover_share();
        let expected = [(1.0 - HOVER_SHARE) * share, ((1.0 + HOVER_SHARE) * share).min(1.0)];
        if (expected[0]..=expected[1]).contains(&self.hover_thrust) {
            return None;
        }
        Some(Remark {
            doubt: Doubt::Unlikely,
            field: "hover_thrust",
            found: self.hover_thrust,
            expected,
            unit: "",
            what: format!(
                "hover_thrust is {}, but the mass of {} kg needs {} of the rotors' full thrust; \
                 expected {} to {}",
                brief(self.hover_thrust),
                brief(self.mass),
                brief(share),
                brief(expected[0]),
                brief(expected[1])
            ),
        })
    }

    fn arm_remark(&self) -> Option<Remark> {
        let arm = self.arm_m();
        let [least, most] = ARM_M;
        if (least..=most).contains(&arm) {
            return None;
        }
        let is_an_arm = |factor: f64| (least..=most).contains(&(factor * arm));
        // Of several units, the one that fits the moments of inertia.
        let gyration = (self.inertia[0] / self.mass).sqrt();
        let fits = |factor: f64| {
            let [least, most] = GYRATION_TILT;
            is_an_arm(factor) && (least..=most).contains(&(gyration / (factor * arm)))
        };
        let advice = looks_like(&ARM_UNITS, "position_m is in m", fits);
        let is_other_unit = ARM_UNITS.iter().any(|(factor, _)| is_an_arm(*factor));
        Some(Remark {
            doubt: if is_other_unit { Doubt::CannotFly } else { Doubt::Unlikely },
            field: "position_m",
            found: arm,
            expected: ARM_M,
            unit: "m",
            what: format!(
                "the rotors are {} m from the centre, expected {least} to {most} m{advice}",
                brief(arm)
            ),
        })
    }

    /// A moment in another unit is off by so much that no loop could hold the vehicle.
    fn inertia_remarks(&self) -> Vec<Remark> {
        let arm = self.arm_m();
        let ranges = [GYRATION_TILT, GYRATION_TILT, GYRATION_YAW];
        let fields = ["inertia[0]", "inertia[1]", "inertia[2]"];
        let expected =
            ranges.map(|range| range.map(|share: f64| self.mass * (share * arm).powi(2)));
        let fit = |factor: f64| {
            let mut pairs = expected.iter().zip(self.inertia);
            pairs.all(|([least, most], moment)| (*least..=*most).contains(&(factor * moment)))
        };
        let advice = looks_like(&INERTIA_UNITS, "inertia is in kg m^2", fit);
        let remarks = expected.into_iter().zip(fields).zip(self.inertia);
        let remarks = remarks.filter_map(|(([least, most], field), moment)| {
            if (least..=most).contains(&moment) {
                return None;
            }
            let is_absurd = moment > INERTIA_ABSURD * most || INERTIA_ABSURD * moment < least;
            Some(Remark {
                doubt: if is_absurd { Doubt::CannotFly } else { Doubt::Unlikely },
                field,
                found: moment,
                expected: [least, most],
                unit: "kg m^2",
                what: format!(
                    "{field} is {} kg m^2; of {} kg with rotors {} m from the centre, {} to {} \
                     kg m^2 are expected{advice}",
                    brief(moment),
                    brief(self.mass),
                    brief(arm),
                    brief(least),
                    brief(most)
                ),
            })
        });
        remarks.collect()
    }

    /// Compares the voltage of each of the `battery.cells` with what cells have.
    fn battery_remark(&self) -> Option<Remark> {
        let found = self.battery.full_v / f64::from(self.battery.cells);
        let [least, most] = CELL_FULL_V;
        if (least..=most).contains(&found) {
            return None;
        }
        Some(Remark {
            doubt: Doubt::Unlikely,
            field: "battery.full_V",
            found,
            expected: CELL_FULL_V,
            unit: "V",
            what: format!(
                "battery.full_V is {} V for {} cells, {} V each, expected {least} to {most} V",
                brief(self.battery.full_v),
                self.battery.cells,
                brief(found)
            ),
        })
    }

    fn loop_remarks(&self) -> Vec<Remark> {
        let Some(pd) = self.attitude_loop_pd() else { return Vec::new() };
        let field = if self.attitude_pd.is_some() { "attitude_pd" } else { "attitude_cascade" };
        let lag = self.motor_time_constant_s + self.command_delay_s.min(ONBOARD_DELAY_MAX_S);
        let mut remarks = Vec::new();
        for (axis, name) in AXES.into_iter().enumerate() {
            let (kp, kd, moment) = (pd.kp[axis], pd.kd[axis], self.inertia[axis]);
            let natural = (kp / moment).sqrt();
            let mut remark = |found: f64, expected: [f64; 2], unit, what: String| {
                if !(expected[0]..=expected[1]).contains(&found) {
                    remarks.push(Remark {
                        doubt: Doubt::Unlikely,
                        field,
                        found,
                        expected,
                        unit,
                        what,
                    });
                }
            };
            let range_text = |expected: [f64; 2]| format!("{} to {}", expected[0], expected[1]);
            remark(
                natural,
                LOOP_RAD_S,
                "rad/s",
                format!(
                    "the on-board loop in {name} turns {} kg m^2 at {} rad/s, expected {} rad/s: \
                     gains (N m/rad) and inertia do not match",
                    brief(moment),
                    brief(natural),
                    range_text(LOOP_RAD_S)
                ),
            );
            let damping = kd / (2.0 * (kp * moment).sqrt());
            if kp > 0.0 {
                remark(
                    damping,
                    LOOP_DAMPING,
                    "",
                    format!(
                        "the on-board loop in {name} has a damping ratio of {}, expected {}",
                        brief(damping),
                        range_text(LOOP_DAMPING)
                    ),
                );
            }
            // A step that corrects more than the whole error overshoots, and twice it never settles.
            let least = kd / moment;
            remark(
                pd.rate_hz,
                [least, LOOP_RATE_MAX_HZ],
                "Hz",
                format!(
                    "the on-board loop runs at {} Hz, but follows rates in {name} within {} s; expected \
                     at least {} Hz",
                    brief(pd.rate_hz),
                    brief(moment / kd),
                    brief(least)
                ),
            );
            let behind = kd / moment * lag;
            remark(
                behind,
                [0.0, RATE_LOOP_LAG],
                "",
                format!(
                    "the on-board loop in {name} follows rates within {} s, but its rotors lag by \
                     {} s: it would oscillate; expected the second below {RATE_LOOP_LAG} times the \
                     first",
                    brief(moment / kd),
                    brief(lag)
                ),
            );
        }
        remarks
    }
}

/// Advice where numbers would make sense in other units than the file's.
fn looks_like(units: &[(f64, &str)], stated: &str, fit: impl Fn(f64) -> bool) -> String {
    let names: Vec<&str> =
        units.iter().filter(|(factor, _)| fit(*factor)).map(|(_, name)| *name).collect();
    if names.is_empty() {
        String::new()
    } else {
        format!("; {stated}: it looks like {}", names.join(" or "))
    }
}

/// Formats a number with three significant digits.
fn brief(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-3..1e5).contains(&size) {
        return format!("{value:.2e}");
    }
    let decimals = (2 - size.max(1e-3).log10().floor() as i32).max(0) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::super::AttitudePd;
    use super::super::tests::quad;
    use super::*;

    fn remarks(change: impl FnOnce(&mut VehicleParams)) -> Vec<Remark> {
        let mut vehicle = quad();
        vehicle.attitude_pd =
            Some(AttitudePd { kp: [1.9, 2.1, 0.52], kd: [0.27, 0.29, 0.19], rate_hz: 250.0 });
        change(&mut vehicle);
        vehicle.remarks()
    }

    #[test]
    fn plausible_vehicle_has_no_remark() {
        assert_eq!(remarks(|_| {}), []);
    }

    #[test]
    fn mass_in_grams_is_recognised() {
        let found = remarks(|v| v.mass = 1200.0);
        assert_eq!(found[0].doubt, Doubt::CannotFly);
        assert_eq!(found[0].field, "mass");
        assert!((found[0].found - 24.0 / (1200.0 * 9.80665)).abs() < 1e-12);
        assert!(found[0].what.contains("looks like grams"), "{}", found[0].what);
        assert!(found[0].what.contains("1.3 to 12 times"), "{}", found[0].what);
    }

    #[test]
    fn inertia_and_arms_in_wrong_units_are_recognised() {
        for (factor, unit) in [(1e4, "kg cm^2"), (1e6, "kg mm^2"), (1e7, "g cm^2"), (1e9, "g mm^2")]
        {
            let found = remarks(|v| v.inertia = v.inertia.map(|moment| factor * moment));
            assert_eq!((found[0].doubt, found[0].field), (Doubt::CannotFly, "inertia[0]"));
            assert!(found[0].what.contains(unit), "{}", found[0].what);
        }
        // In the right unit, but an unusual vehicle.
        let found = remarks(|v| v.inertia = v.inertia.map(|moment| 8.0 * moment));
        assert!(found.iter().all(|remark| remark.doubt == Doubt::Unlikely), "{found:?}");
        let found = remarks(|v| v.inertia = [1e-300; 3]);
        assert_eq!(found[0].doubt, Doubt::CannotFly);
        for (factor, unit) in [(100.0, "looks like cm"), (1e3, "looks like mm")] {
            let found = remarks(|v| {
                let rotors = v.rotors.iter_mut().flat_map(|rotor| &mut rotor.position_m);
                rotors.for_each(|place| *place *= factor);
            });
            assert_eq!((found[0].doubt, found[0].field), (Doubt::CannotFly, "position_m"));
            assert!(found[0].what.contains(unit), "{}", found[0].what);
            assert!(found.iter().all(|remark| !remark.field.starts_with("inertia")), "{found:?}");
        }
    }

    #[test]
    fn related_numbers_are_cross_checked() {
        let field = |change: &dyn Fn(&mut VehicleParams)| remarks(change).first().map(|r| r.field);
        assert_eq!(field(&|v| v.hover_thrust = 0.3), Some("hover_thrust"));
        // In kg cm^2.
        assert_eq!(field(&|v| v.inertia = [110.0, 120.0, 210.0]), Some("inertia[0]"));
        assert_eq!(field(&|v| v.inertia[2] = 0.0005), Some("inertia[2]"));
        // Normalised gains in place of N m.
        let normalised = |v: &mut VehicleParams| {
            v.attitude_pd = Some(AttitudePd { kp: [4.0; 3], kd: [0.0015; 3], rate_hz: 250.0 });
        };
        assert_eq!(field(&normalised), Some("attitude_pd"));
        let slow = remarks(|v| v.motor_time_constant_s = 0.3);
        assert!(slow[0].what.contains("rotors lag by 0.305 s"), "{}", slow[0].what);
        let rare = |v: &mut VehicleParams| {
            v.attitude_pd = v.attitude_pd.map(|pd| AttitudePd { rate_hz: 1.0, ..pd });
        };
        assert!(remarks(rare)[0].what.contains("runs at 1.00 Hz"), "{:?}", remarks(rare));
        let millivolts = |v: &mut VehicleParams| v.battery.full_v = 16800.0;
        assert_eq!(field(&millivolts), Some("battery.full_V"));
        let strong = remarks(|v| v.rotors.iter_mut().for_each(|r| r.thrust_max_n = 60.0));
        assert_eq!((strong[0].doubt, strong[0].field), (Doubt::Unlikely, "mass"));
    }

    #[test]
    fn numbers_are_printed_briefly() {
        let printed = [0.0, 0.0123456, 1.23456, 12.3456, 1234.56, 1.0e300, 2.0e-7].map(brief);
        assert_eq!(printed, ["0.00000", "0.0123", "1.23", "12.3", "1235", "1.00e300", "2.00e-7"]);
    }
}
