//! Cases for the search for laws: vehicles with a law outside the catalogue or with none, on
//! flights of the exam's programme and on another mission.

use std::collections::BTreeMap;

use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::law::{Law, LawText};

use super::airframe;
use super::attempts::CaseError;
use super::bench::{Bench, Truth};
use super::draw::{Draw, rounded};
use super::order::{Kind, Order, Settings};
use crate::diagnose::likelihood::noise::ReportNoise;

/// Most draws for a case.
const ATTEMPTS: u64 = 8;
/// Flights of the other mission, which no law is fitted to.
const MISSION: usize = 2;
/// Range of a law's force at 2 m/s, as a share of the weight; and its moment, as a share of that of
/// the same force at the rotors' arm.
const SHARES: [f64; 2] = [0.03, 0.15];
const MOMENT: f64 = 0.02;

/// A kind of law, in terms of the constants that [`draw_law`] draws.
struct LawKind {
    name: &'static str,
    /// The variables that it depends on, in terms of [`variables`].
    variables: &'static [&'static str],
    /// Formula of each channel.
    formulas: &'static [(&'static str, &'static str)],
}

/// All kinds. The last three are outside the grammar of the search.
const KINDS: [LawKind; 14] = [
    LawKind {
        name: "drag to a power",
        variables: &["air"],
        formulas: &[
            ("force_x", "-f * air_x / v * (airspeed / v)^n"),
            ("force_y", "-f * air_y / v * (airspeed / v)^n"),
            ("force_z", "-f * air_z / v * (airspeed / v)^n"),
        ],
    },
    LawKind {
        name: "drag of plates",
        variables: &["air"],
        formulas: &[
            ("force_x", "-a * f * air_x * abs(air_x) / v^2"),
            ("force_y", "-b * f * air_y * abs(air_y) / v^2"),
        ],
    },
    LawKind {
        name: "linear and quadratic drag",
        variables: &["air"],
        formulas: &[
            ("force_x", "-f * air_x / v * (0.5 * a + 0.5 * b * airspeed / v)"),
            ("force_y", "-f * air_y / v * (0.5 * a + 0.5 * b * airspeed / v)"),
        ],
    },
    LawKind {
        name: "vertical drag",
        variables: &["air"],
        formulas: &[("force_z", "-2 * f * air_z * abs(air_z) / v^2")],
    },
    LawKind {
        name: "force across a turn",
        variables: &["air", "yaw rate"],
        formulas: &[
            ("force_x", "-f * rate_z * 1[s] * air_y / v"),
            ("force_y", "f * rate_z * 1[s] * air_x / v"),
        ],
    },
    LawKind {
        name: "side force of a turn",
        variables: &["yaw rate"],
        formulas: &[("force_y", "f * rate_z * 1[s]")],
    },
    LawKind {
        name: "lever",
        variables: &["air"],
        formulas: &[("moment_x", "m * air_y / v"), ("moment_y", "-m * air_x / v")],
    },
    LawKind {
        name: "lift to a power",
        variables: &["air"],
        formulas: &[("thrust", "s * (airspeed_xy / v)^n")],
    },
    LawKind {
        name: "decay with height",
        variables: &["height"],
        formulas: &[("thrust", "2 * s * exp(-height / l)")],
    },
    LawKind {
        name: "drag along one axis",
        variables: &["air"],
        formulas: &[("force_x", "-f * air_x / v")],
    },
    LawKind {
        name: "sagging thrust",
        variables: &["voltage"],
        formulas: &[("thrust", "-6 * abs(s) * (1 - voltage_share)")],
    },
    LawKind {
        name: "saturating drag",
        variables: &["air"],
        formulas: &[
            ("force_x", "-2 * f * air_x / (v + airspeed)"),
            ("force_y", "-2 * f * air_y / (v + airspeed)"),
            ("force_z", "-2 * f * air_z / (v + airspeed)"),
        ],
    },
    LawKind {
        name: "saturating lift",
        variables: &["air"],
        formulas: &[("thrust", "2 * s * airspeed_xy^2 / (v^2 + airspeed_xy^2)")],
    },
    LawKind {
        name: "drag that grows as an exponential",
        variables: &["air"],
        formulas: &[
            ("force_x", "-0.6 * f * air_x / v * exp(0.5 * airspeed / v)"),
            ("force_y", "-0.6 * f * air_y / v * exp(0.5 * airspeed / v)"),
        ],
    },
];

/// A drawn law.
#[derive(Clone, Debug)]
pub struct DrawnLaw {
    /// The kind's name.
    pub kind: &'static str,
    /// The variables that it depends on, in terms of [`variables`].
    pub variables: &'static [&'static str],
    /// The law's formulas.
    pub law: Law,
}

/// The variables behind a law's quantities, for comparison: every velocity counts as the air's.
pub fn variables<'a>(quantities: impl IntoIterator<Item = &'a str>) -> Vec<&'static str> {
    let of = |name: &str| match name {
        "rate_z" => "yaw rate",
        "rate_x" | "rate_y" => "tilting rate",
        "height" => "height",
        "heading" => "heading",
        "voltage" | "voltage_share" => "voltage",
        "thrust" | "rotor_speed" => "thrust",
        "rotor_moment_x" | "rotor_moment_y" | "rotor_moment_z" => "rotors' moment",
        _ => "air",
    };
    let mut all: Vec<&'static str> = quantities.into_iter().map(of).collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn draw_law(draw: &mut Draw, vehicle: &VehicleParams) -> Option<DrawnLaw> {
    let &LawKind { name, variables, formulas } = &KINDS[draw.below(KINDS.len())];
    let weight = vehicle.mass * vehicle.gravity;
    let arm = airframe::arm_m(vehicle);
    let share = draw.log_within(SHARES);
    let force = rounded(share * weight);
    let (along, across) = (rounded(draw.within([0.4, 1.0])), rounded(draw.within([0.4, 1.0])));
    let power = rounded(draw.within([1.2, 2.4]));
    let length = rounded(draw.within([0.2, 0.8]));
    let sign = draw.sign();
    let text = LawText {
        constants: BTreeMap::from([
            ("f".to_owned(), format!("{force} N")),
            ("m".to_owned(), format!("{} N m", rounded(share * weight * arm * MOMENT / SHARES[0]))),
            ("v".to_owned(), "2 m/s".to_owned()),
            ("a".to_owned(), along.to_string()),
            ("b".to_owned(), across.to_string()),
            ("n".to_owned(), rounded(power - 1.0).to_string()),
            ("l".to_owned(), format!("{length} m")),
            ("s".to_owned(), rounded(sign * share).to_string()),
        ]),
        formulas: formulas.iter().map(|(at, formula)| ((*at).into(), (*formula).into())).collect(),
        ..LawText::default()
    };
    Some(DrawnLaw { kind: name, variables, law: Law::new("hidden", text).ok()? })
}

/// A case with its flown logs.
#[derive(Clone, Debug)]
pub struct LawCase {
    /// The vehicle file.
    pub nominal: VehicleParams,
    /// The file with the vehicle's numbers.
    pub known: VehicleParams,
    /// Logs to fit a law to.
    pub logs: Vec<Vec<u8>>,
    /// Logs of the other mission.
    pub mission: Vec<Vec<u8>>,
    /// The law; `None` for a null.
    pub law: Option<DrawnLaw>,
    /// The law as an effect set.
    pub truth: EffectSet,
    /// Noise of the reported state.
    pub noise: ReportNoise,
}

impl LawCase {
    /// Draws and flies case `number` of the exam with this seed, with a law or without.
    ///
    /// # Errors
    /// [`CaseError`].
    pub fn fly(
        settings: &Settings,
        seed: u64,
        number: u64,
        has_law: bool,
    ) -> Result<Self, CaseError> {
        let mut last = None;
        for attempt in 0..ATTEMPTS {
            let mut draw = Draw::new(seed, number * ATTEMPTS + attempt + 1);
            let name = format!("case_{number:03}");
            let order = Order::from(Kind::Null);
            let mut bench = Bench::draw(&mut draw, settings, &name, &order)?;
            bench.add_flights(&mut draw, MISSION);
            let law = if has_law { draw_law(&mut draw, &bench.nominal) } else { None };
            let mut effects = EffectSet::new();
            if let Some(drawn) = &law {
                // The set is empty, so the law fits.
                let _ = effects.insert_law(drawn.law.clone());
            }
            let truth = Truth::from(effects.clone());
            match bench.logs(&truth) {
                Ok(mut logs) => {
                    let mission = logs.split_off(logs.len().saturating_sub(MISSION));
                    let noise = bench.noise();
                    let known = bench.known(&truth);
                    return Ok(Self {
                        nominal: bench.nominal,
                        known,
                        logs,
                        mission,
                        law,
                        truth: effects,
                        noise,
                    });
                }
                Err(error) => last = Some(error),
            }
        }
        Err(match last {
            Some(error) => CaseError::Unflyable(error),
            None => CaseError::Unflyable(super::flight::FlightError::Lost(0.0)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_law_kind_parses_and_depends_on_its_variables() {
        let vehicle = VehicleParams::load("quad1200").unwrap();
        let mut draw = Draw::new(1, 1);
        let mut seen = std::collections::BTreeSet::new();
        for _ in 0..400 {
            let drawn = draw_law(&mut draw, &vehicle).expect("a law");
            let read: Vec<&str> = drawn.law.needed().iter().map(|q| q.name()).collect();
            assert_eq!(variables(read), drawn.variables, "{}", drawn.kind);
            seen.insert(drawn.kind);
        }
        assert_eq!(seen.len(), KINDS.len());
    }
}
