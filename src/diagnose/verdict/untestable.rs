//! Effects of the catalogue that a log's channels cannot show, whatever was flown.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::{EffectId, Need};

use crate::audit::{Channels, FAST_HZ, Rates};
use crate::log::import::Flight;

/// A voltage whose range is below this share of its maximum shows no sag.
const VOLTAGE_RANGE: f64 = 0.02;

/// An effect that a log cannot show.
#[derive(Clone, Debug, PartialEq, Eq, JsonSchema, Serialize)]
pub struct Untestable {
    /// Its id in the catalogue.
    #[schemars(with = "String")]
    pub effect: EffectId,
    /// What is missing in the log.
    pub reason: String,
}

/// Lowest and highest voltage, V.
pub(in crate::diagnose) fn voltage_range(voltages: impl Iterator<Item = f64>) -> [f64; 2] {
    voltages.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
}

/// Whether voltages in this range are too constant to show a sag.
pub(in crate::diagnose) fn is_flat([low, high]: [f64; 2]) -> bool {
    high - low < VOLTAGE_RANGE * high
}

/// The effects of the catalogue that these channels cannot show, with the reason.
pub fn of(flight: &Flight, channels: &Channels) -> Vec<Untestable> {
    let missing = |effect: EffectId| {
        reason(effect, flight, channels).map(|reason| Untestable { effect, reason })
    };
    EffectId::ALL.into_iter().filter_map(missing).collect()
}

fn reason(id: EffectId, flight: &Flight, channels: &Channels) -> Option<String> {
    id.spec().needs.iter().find_map(|need| lacking(*need, flight, channels))
}

/// Why these channels do not meet a need, if they do not.
fn lacking(need: Need, flight: &Flight, channels: &Channels) -> Option<String> {
    let lacks = |has: bool, what: &str| (!has).then(|| what.to_owned());
    let driven = channels.outputs || channels.rotor_speed || channels.setpoint;
    let rotors = channels.outputs || channels.rotor_speed;
    let no_rotors = if channels.setpoint {
        "motor outputs are not logged, so rotors cannot be distinguished; with attitude_pd in the \
         vehicle file, diagnose computes them from the setpoints"
    } else {
        "motor outputs are not logged, so rotors cannot be distinguished"
    };
    match need {
        Need::Input => {
            lacks(driven, "neither motor outputs, rotor speeds nor setpoints are logged")
        }
        Need::Pose => lacks(channels.pose(), "position, velocity and attitude are not all logged"),
        Need::Motion => {
            lacks(channels.pose() || channels.imu, "neither pose nor accelerometer is logged")
        }
        Need::Moment => lacks(
            channels.body_rate || channels.attitude,
            "neither body rate nor attitude is logged",
        )
        .or(lacks(rotors, no_rotors)),
        Need::FastInput if channels.setpoint => None,
        Need::FastOutputs | Need::FastInput => {
            let is_slow = channels.outputs && !channels.fast_outputs && !channels.rotor_speed;
            is_slow.then(|| slow_outputs(flight))
        }
        Need::Voltage => {
            let range @ [low, high] = voltage_range(flight.voltage.values().iter().copied());
            let flat = || format!("the voltage stays between {low:.2} and {high:.2} V in this log");
            lacks(channels.voltage, "the voltage is not logged")
                .or_else(|| is_flat(range).then(flat))
        }
        Need::Attitude => lacks(channels.attitude, "the attitude is not logged").or(lacks(
            channels.motion || channels.body_rate,
            "the attitude is logged without velocity or body rate",
        )),
        Need::Imu => lacks(
            channels.imu,
            "no IMU is logged at 80 Hz or more, so the estimate's latency cannot be measured",
        ),
        Need::WholeSetpoint => lacks(
            channels.whole_setpoint,
            "the log has no setpoints with attitude, rates and thrust as the ground sent them",
        ),
    }
}

fn slow_outputs(flight: &Flight) -> String {
    match Rates::of(flight).outputs_hz {
        Some(rate) => {
            format!("motor outputs update at only {rate:.1} Hz; at least {FAST_HZ:.0} Hz is needed")
        }
        None => format!(
            "the motor outputs hardly change in this log; updates at {FAST_HZ:.0} Hz or more are \
             needed"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Channels = Channels {
        attitude: true,
        motion: true,
        body_rate: true,
        imu: true,
        outputs: true,
        fast_outputs: true,
        voltage: true,
        rotor_speed: true,
        setpoint: true,
        whole_setpoint: true,
    };
    /// Without position and velocity.
    const OF_PLACES: [&str; 9] = [
        "blade_flapping",
        "estimator_latency",
        "ground_effect",
        "gusts",
        "parasitic_drag",
        "rotor_drag",
        "translational_lift",
        "vortex_ring",
        "wind",
    ];

    fn untestable(channels: Channels, voltages: [f64; 2]) -> Vec<Untestable> {
        let mut flight = Flight::in_memory("a", "csv");
        for (time, voltage) in [0.0, 1.0].into_iter().zip(voltages) {
            flight.voltage.push(time, voltage);
        }
        of(&flight, &channels)
    }

    fn names(channels: Channels) -> Vec<&'static str> {
        let untestable = untestable(channels, [12.0, 11.0]);
        let mut names: Vec<_> = untestable.iter().map(|one| one.effect.name()).collect();
        names.sort_unstable();
        names
    }

    #[test]
    fn each_missing_channel_leaves_its_effects_untestable() {
        assert_eq!(names(ALL), [""; 0]);
        assert_eq!(names(Channels { voltage: false, ..ALL }), ["battery_sag"]);
        assert_eq!(names(Channels { imu: false, ..ALL }), ["estimator_latency"]);
        assert_eq!(names(Channels { whole_setpoint: false, ..ALL }), ["pd_gain"]);
        let still = Channels { motion: false, ..ALL };
        assert_eq!(names(still), OF_PLACES);
        // Without a body rate too, nothing compares the attitude.
        let found = names(Channels { body_rate: false, ..still });
        assert_eq!((found.len(), found[0]), (OF_PLACES.len() + 1, "attitude_trim"));
        let found = names(Channels { attitude: false, ..ALL });
        assert_eq!((found.len(), found[0]), (OF_PLACES.len() + 1, "attitude_trim"));
        // Neither a pose nor an accelerometer shows a force, and nothing a moment.
        let found = names(Channels { imu: false, ..still });
        assert!(["mass", "thrust_curve"].iter().all(|id| found.contains(id)), "{found:?}");
        let blind = Channels { attitude: false, body_rate: false, ..ALL };
        assert!(names(blind).contains(&"com_offset"));
    }

    #[test]
    fn commands_replace_each_other_as_far_as_they_can() {
        let is_shown = |channels: Channels| {
            let found = names(channels);
            ["wind", "command_delay", "inertia", "yaw_torque"].map(|id| !found.contains(&id))
        };
        let none = Channels { outputs: false, fast_outputs: false, ..ALL };
        let none = Channels { rotor_speed: false, setpoint: false, ..none };
        assert_eq!(is_shown(none), [false, false, false, false]);
        assert_eq!(is_shown(Channels { setpoint: true, ..none }), [true, true, false, false]);
        assert_eq!(is_shown(Channels { rotor_speed: true, ..none }), [true; 4]);
        let slow = Channels { outputs: true, ..none };
        assert_eq!(is_shown(slow), [true, false, false, true]);
        assert_eq!(is_shown(Channels { fast_outputs: true, ..slow }), [true; 4]);
        assert_eq!(is_shown(Channels { rotor_speed: true, ..slow }), [true; 4]);
        assert_eq!(is_shown(Channels { setpoint: true, ..slow }), [true, true, false, true]);
        // Setpoints drive the rotors with the gains of the loop.
        let advises = |setpoint| {
            let untestable = untestable(Channels { setpoint, ..none }, [12.0, 11.0]);
            untestable.iter().any(|one| one.reason.contains("attitude_pd"))
        };
        assert_eq!([false, true].map(advises), [false, true]);
        let slow = untestable(slow, [12.0, 11.0]);
        assert!(slow.iter().all(|one| one.reason.contains("40 Hz")), "{slow:?}");
    }

    #[test]
    fn constant_voltage_shows_no_sag() {
        let untestable = untestable(ALL, [11.9, 12.0]);
        assert_eq!(untestable.len(), 1);
        assert_eq!(untestable[0].effect, EffectId::BatterySag);
        assert!(untestable[0].reason.contains("between 11.90 and 12.00 V"), "{untestable:?}");
    }
}
