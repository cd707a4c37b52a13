//! Which effects of the catalogue a log's channels cannot show, whatever was flown.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::EffectId;

use crate::audit::{Channels, FAST_HZ, Rates};
use crate::log::import::Flight;

/// A voltage that changes less than this share shows no sag.
const VOLTAGE_RANGE: f64 = 0.02;

/// An effect that a log cannot show.
#[derive(Clone, Debug, PartialEq, Eq, JsonSchema, Serialize)]
pub struct Untestable {
    /// Its id in the catalogue.
    #[schemars(with = "String")]
    pub effect: EffectId,
    /// What is missing.
    pub reason: String,
}

/// Lowest and highest voltage, V.
pub(super) fn voltage_range(voltages: impl Iterator<Item = f64>) -> [f64; 2] {
    voltages.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
}

/// Whether voltages within a range show no sag.
pub(super) fn is_flat([low, high]: [f64; 2]) -> bool {
    high - low < VOLTAGE_RANGE * high
}

/// The effects of the catalogue that these channels cannot show, whatever was flown.
pub fn of(flight: &Flight, channels: &Channels) -> Vec<Untestable> {
    let missing = |effect: EffectId| {
        reason(effect, flight, channels).map(|reason| Untestable { effect, reason })
    };
    EffectId::ALL.into_iter().filter_map(missing).collect()
}

fn reason(id: EffectId, flight: &Flight, channels: &Channels) -> Option<String> {
    use EffectId as E;
    let lacks = |has: bool, what: &str| (!has).then(|| what.to_owned());
    let driven = channels.outputs || channels.rotor_speed || channels.setpoint;
    let input = || lacks(driven, "nothing that was commanded is logged");
    let pose = || lacks(channels.pose(), "position, velocity and attitude are not all logged");
    let motion =
        || lacks(channels.pose() || channels.imu, "neither pose nor accelerometer is logged");
    let moment = || {
        lacks(channels.body_rate || channels.attitude, "neither body rate nor attitude is logged")
            .or(lacks(
                channels.outputs || channels.rotor_speed,
                "motor outputs are not logged, so that rotors cannot be told apart",
            ))
    };
    let fast = || {
        let slow = || match Rates::of(flight).outputs_hz {
            Some(rate) => format!(
                "new motor outputs come at {rate:.1} Hz only; at least {FAST_HZ:.0} Hz are needed"
            ),
            None => format!(
                "the motor outputs hardly change in this log; new ones at {FAST_HZ:.0} Hz or more \
                 are needed"
            ),
        };
        let is_slow = channels.outputs && !channels.fast_outputs && !channels.rotor_speed;
        is_slow.then(slow)
    };
    match id {
        E::ThrustScale | E::Mass | E::ThrustCurve => input().or_else(motion),
        E::BatterySag => {
            let range @ [low, high] = voltage_range(flight.voltage.values().iter().copied());
            let is_flat = channels.voltage && is_flat(range);
            let flat = || format!("the voltage stays within {low:.2} to {high:.2} V in this log");
            input()
                .or_else(motion)
                .or(lacks(channels.voltage, "the voltage is not logged"))
                .or_else(|| is_flat.then(flat))
        }
        E::RotorLoss | E::ComOffset | E::YawTorque => moment(),
        E::MotorLag | E::Inertia => moment().or_else(fast),
        E::CommandDelay => {
            input().or_else(motion).or_else(|| if channels.setpoint { None } else { fast() })
        }
        E::RotorDrag
        | E::ParasiticDrag
        | E::Wind
        | E::Gusts
        | E::TranslationalLift
        | E::VortexRing
        | E::GroundEffect => pose().or_else(input),
        E::BladeFlapping => pose().or_else(moment),
        E::RotorGyroscopic => moment().or_else(fast),
        E::AttitudeTrim => lacks(channels.attitude, "the attitude is not logged").or_else(|| {
            lacks(
                channels.motion || channels.body_rate,
                "neither velocity nor body rate is logged beside the attitude",
            )
        }),
        E::EstimatorLatency => pose().or(lacks(
            channels.imu,
            "no IMU is logged at 80 Hz or more, against which the estimate could be late",
        )),
        E::PdGain => moment().or(lacks(
            channels.whole_setpoint,
            "setpoints with attitude, rates and thrust, as the ground sent them, are not logged",
        )),
    }
}
