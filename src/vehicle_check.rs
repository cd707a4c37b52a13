//! Compares a vehicle file with a flight: its predictions of the hover, the outputs and the
//! on-board loop with what the log shows.

mod gains;
mod hover;
mod outputs;
mod response;

use std::ops::Range;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::{ROTORS, VehicleParams};

use crate::learn::segments::in_air;
use crate::log::import::{Flight, VehicleFacts};

/// Share of the hover output above which a mean output carries the vehicle.
const LIFTS: f64 = 0.5;

/// Whether a log agrees with a number that the file predicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The log agrees with the file, within the check's tolerance and the log's chance variation.
    Fits,
    /// The log contradicts the file.
    Differs,
    /// The log does not show the number.
    NotShown,
}

/// The comparison of one number.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Held {
    /// The check: `hover`, `outputs`, `roll`, `pitch`, `yaw`, `gains`.
    pub check: &'static str,
    /// The field of the file to examine first.
    pub field: &'static str,
    /// The verdict of the log.
    pub verdict: Verdict,
    /// The prediction of the file.
    pub expected: f64,
    /// The value in the log.
    pub found: Option<f64>,
    /// Half of the 95 % interval of `found`, where it has one.
    pub half_width: Option<f64>,
    /// Unit of all three; empty for shares and gains.
    pub unit: &'static str,
    /// The comparison as a sentence.
    pub what: String,
}

/// Why nothing can be compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotHeld {
    /// The log shows no flight in the air.
    #[error("the log shows no flight of more than {needed_s} s in the air")]
    NoFlight {
        /// Required time in the air, s.
        needed_s: f64,
    },
    /// The log is of something else than a quadrotor.
    #[error("the log is of {0}: only quadrotors are supported, and nothing of the file is shown")]
    OtherVehicle(String),
    /// The outputs have no known unit.
    #[error(transparent)]
    Unit(#[from] crate::log::import::UnitUnknown),
}

/// The shortest flight that is examined, s.
const FLIGHT_MIN_S: f64 = 5.0;
/// Length of the blocks that show the chance variation, s.
const BLOCK_S: f64 = 4.0;

/// What a log's vehicle is, where the log states that it is no quadrotor.
pub fn other_vehicle(facts: &VehicleFacts) -> Option<String> {
    let motors = facts.motors.filter(|motors| *motors as usize != ROTORS);
    match facts.stated_otherwise() {
        Some(stated) => Some(format!("{} ({})", stated.kind, stated.by)),
        None => motors.map(|motors| format!("a vehicle with {motors} motors")),
    }
}

/// Compares `vehicle` with `flight`, one sentence for each number.
///
/// # Errors
/// [`NotHeld`] where the log shows no flight, or its outputs have no unit.
pub fn held(flight: &Flight, vehicle: &VehicleParams) -> Result<Vec<Held>, NotHeld> {
    if let Some(kind) = other_vehicle(&flight.facts) {
        return Err(NotHeld::OtherVehicle(kind));
    }
    let mut shares = flight.clone();
    shares.normalise_outputs(vehicle)?;
    let spans = in_air(&shares, LIFTS * vehicle.hover_share());
    if spans.iter().map(|span| span.end - span.start).sum::<f64>() < FLIGHT_MIN_S {
        return Err(NotHeld::NoFlight { needed_s: FLIGHT_MIN_S });
    }
    let mut all = vec![hover::held(&shares, &spans, vehicle)];
    all.push(outputs::held(flight, &shares, &spans, vehicle));
    all.extend(response::held(&shares, &spans, vehicle));
    all.extend(gains::held(flight, vehicle));
    Ok(all)
}

/// Divides spans into blocks of [`BLOCK_S`]; the rest at a span's end is dropped.
fn blocks(spans: &[Range<f64>]) -> Vec<Range<f64>> {
    let of = |span: &Range<f64>| {
        let (start, count) = (span.start, ((span.end - span.start) / BLOCK_S).floor() as u32);
        (0..count).map(move |k| {
            let from = start + f64::from(k) * BLOCK_S;
            from..from + BLOCK_S
        })
    };
    spans.iter().flat_map(of).collect()
}

/// A number with three digits, for people.
fn brief(value: f64) -> String {
    let decimals = (2 - value.abs().max(1e-3).log10().floor() as i32).max(0) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use vehicle::AttitudeCascade;
    use vehicle::frame::{Euler, Frd, Ned};

    use super::*;
    use crate::log::import::{AttitudeSetpoint, SetpointSource};

    fn file() -> VehicleParams {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/config/vehicles/quad1200.toml");
        VehicleParams::load(file).expect("a vehicle")
    }

    /// A flight of `vehicle` with its PD law, from equations that are independent of the program's.
    fn flown(vehicle: &VehicleParams, size: f64) -> Flight {
        let pd = vehicle.attitude_pd.expect("a PD");
        flown_by(vehicle, size, |axis, setpoint_angle, angle, rate| {
            (setpoint_angle, pd.kp[axis] * (setpoint_angle - angle) - pd.kd[axis] * rate)
        })
    }

    /// A flight of `vehicle` with a new random setpoint of up to `size` rad once a second. The loop
    /// maps axis, desired angle, angle and rate to the logged setpoint and the moment.
    fn flown_by(
        vehicle: &VehicleParams,
        size: f64,
        mut law: impl FnMut(usize, f64, f64, f64) -> (f64, f64),
    ) -> Flight {
        let mut flight = Flight::in_memory("a", "mcap");
        let (mut angle, mut rate, mut moment) = ([0.0_f64; 3], [0.0_f64; 3], [0.0_f64; 3]);
        let (mut setpoint_angle, mut seed) = ([0.0_f64; 3], 1_u64);
        flight.setpoint_source = SetpointSource::Onboard;
        flight.in_air.push(-1.0, true);
        for k in 0..40_000_u32 {
            let time = f64::from(k) * 1e-3;
            if k.is_multiple_of(1000) {
                setpoint_angle = std::array::from_fn(|_| {
                    seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    size * ((seed >> 40) as f64 / f64::from(1 << 23) - 1.0)
                });
            }
            let mut logged = [0.0; 3];
            let mut moments = [0.0; 3];
            for axis in 0..3 {
                (logged[axis], moments[axis]) =
                    law(axis, setpoint_angle[axis], angle[axis], rate[axis]);
            }
            if k.is_multiple_of(10) {
                let attitude = Euler::new(logged[0], logged[1], logged[2]).attitude();
                let setpoint =
                    AttitudeSetpoint { attitude: Some(attitude), body_rate: None, thrust: None };
                flight.setpoint.push(time, setpoint);
            }
            if k.is_multiple_of(4) {
                flight.attitude.push(time, Euler::new(angle[0], angle[1], angle[2]).attitude());
                flight.velocity.push(time, Ned::zero());
                flight.body_rate.push(time, Frd::new(rate[0], rate[1], rate[2]));
                let share = vehicle.hover_share() / (angle[0].cos() * angle[1].cos());
                flight.outputs.push(time, [share; 4]);
            }
            for axis in 0..3 {
                let lag = vehicle.motor_time_constant_s;
                moment[axis] += 1e-3 * (moments[axis] - moment[axis]) / lag;
                rate[axis] += 1e-3 * moment[axis] / vehicle.inertia[axis];
                angle[axis] += 1e-3 * rate[axis];
            }
        }
        flight
    }

    fn verdicts(flight: &Flight, vehicle: &VehicleParams) -> Vec<(&'static str, Verdict)> {
        let held = held(flight, vehicle).expect("a flight");
        held.iter().map(|held| (held.check, held.verdict)).collect()
    }

    #[test]
    fn file_of_the_flown_vehicle_fits() {
        let vehicle = file();
        let expected = ["hover", "outputs", "roll", "pitch", "yaw"].map(|of| (of, Verdict::Fits));
        assert_eq!(verdicts(&flown(&vehicle, 0.15), &vehicle), expected);
    }

    /// ArduCopter's log contains the target after shaping. The file's loop follows it without
    /// shaping it again, and feeds its rate forward.
    #[test]
    fn onboard_shaped_target_is_not_shaped_again() {
        let mut vehicle = file();
        let inertia = vehicle.inertia;
        vehicle.attitude_pd = None;
        let cascade = AttitudeCascade {
            rate_hz: 400.0,
            angle_p_per_s: [4.5; 3],
            rate_max_rad_s: [100.0; 3],
            rate_p_nms: inertia.map(|inertia| 12.0 * inertia),
            rate_i_nm: [0.0; 3],
            rate_d_nms2: [0.0; 3],
            rate_ff_nms: [0.0; 3],
            integral_max_nm: [0.0; 3],
            gyro_cutoff_hz: 100.0,
            derivative_cutoff_hz: 20.0,
            input_time_constant_s: Some(0.25),
        };
        vehicle.attitude_cascade = Some(cascade);
        let mut target = [0.0; 3];
        let flight = flown_by(&vehicle, 0.15, |axis, setpoint_angle, angle, rate| {
            let forward = (setpoint_angle - target[axis]) / 0.25;
            target[axis] += 1e-3 * forward;
            let desired = 4.5 * (target[axis] - angle) + forward;
            (target[axis], 12.0 * inertia[axis] * (desired - rate))
        });
        let mut axes = 0;
        for held in held(&flight, &vehicle).expect("a flight") {
            if ["roll", "pitch", "yaw"].contains(&held.check) {
                assert_eq!(held.verdict, Verdict::Fits, "{}", held.what);
                assert!(held.found.expect("found") / held.expected < 1.15, "{}", held.what);
                axes += 1;
            }
        }
        assert_eq!(axes, 3);
    }

    #[test]
    fn difference_is_reported_with_both_numbers() {
        let (vehicle, mut heavy) = (file(), file());
        let flight = flown(&vehicle, 0.15);
        heavy.mass *= 1.3;
        let [hover, ..] = &held(&flight, &heavy).expect("a flight")[..] else { panic!("none") };
        assert_eq!(hover.verdict, Verdict::Differs, "{}", hover.what);
        let found = hover.found.expect("found");
        assert!((found / vehicle.hover_share() - 1.0).abs() < 0.01, "{}", hover.what);

        let mut slow = file();
        slow.inertia[0] *= 4.0;
        let all = held(&flight, &slow).expect("a flight");
        let roll = all.iter().find(|held| held.check == "roll").expect("roll");
        assert_eq!(roll.verdict, Verdict::Differs, "{}", roll.what);
        assert!(roll.found.expect("found") < roll.expected, "{}", roll.what);
        assert!(roll.what.contains("expected"), "{}", roll.what);
        let pitch = all.iter().find(|held| held.check == "pitch").expect("pitch");
        assert_eq!(pitch.verdict, Verdict::Fits, "{}", pitch.what);
    }

    #[test]
    fn still_hover_does_not_reveal_the_loop() {
        let vehicle = file();
        let all = verdicts(&flown(&vehicle, 0.005), &vehicle);
        assert_eq!(all[0], ("hover", Verdict::Fits));
        assert_eq!(all[2..], ["roll", "pitch", "yaw"].map(|of| (of, Verdict::NotShown)));
    }

    #[test]
    fn another_vehicle_shows_nothing_of_the_file() {
        let vehicle = file();
        let mut flight = flown(&vehicle, 0.15);
        flight.facts.motors = Some(6);
        let refused = held(&flight, &vehicle).expect_err("six motors").to_string();
        assert!(refused.contains("6 motors"), "{refused}");
    }

    #[test]
    fn output_range_that_contradicts_the_parameters_is_reported() {
        let mut vehicle = file();
        let mut flight = flown(&vehicle, 0.15);
        for outputs in flight.outputs.values_mut() {
            *outputs = outputs.map(|u| 1000.0 + 1000.0 * u);
        }
        flight.motor_unit = crate::log::import::MotorUnit::VehicleFile;
        let range = crate::log::import::OutputRange { zero: 1000.0, one: 2000.0 };
        flight.facts.output_ranges = Some([range; 4]);
        vehicle.motor_output = None;
        assert_eq!(verdicts(&flight, &vehicle)[1], ("outputs", Verdict::Fits));
        vehicle.motor_output = Some(vehicle::MotorOutput {
            message: "SERVO_OUTPUT_RAW".to_owned(),
            fields: Vec::new(),
            zero: 1100.0,
            one: 1900.0,
            disarmed: 900.0,
        });
        assert_eq!(verdicts(&flight, &vehicle)[1], ("outputs", Verdict::Differs));
    }
}
