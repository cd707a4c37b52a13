//! Scripts drawn from a seed: vehicle, autopilot, trajectory, controller, faults.

use sitl::config::Autopilot;

use super::script::{Fault, PilotAct, Script, Timed, VERSION, Way};
use crate::control::LAWS;
use crate::exam::draw::{Draw, rounded};
use crate::supervisor::EngagePolicy;

/// Approximate length of a drawn flight from connecting to disarming, s.
const FLIGHT_S: f64 = 21.0;
/// Most scenes of faults in a flight.
const FAULTS_MAX: usize = 4;
/// When the pilot switches to OFFBOARD and arms, under the pilot's switch, s.
const SWITCH_S: f64 = 5.5;

/// Flight `number` of the campaign with this seed.
pub fn script(seed: u64, number: u64) -> Script {
    let draw = &mut Draw::new(seed, number);
    let autopilot = draw.one_of(&[
        (Autopilot::Bundled, 0.4),
        (Autopilot::Px4, 0.35),
        (Autopilot::Arducopter, 0.25),
    ]);
    let vehicle = if draw.chance(0.5) { "crazyflie" } else { "quad1200" };
    let policy = if draw.chance(0.75) { EngagePolicy::Command } else { EngagePolicy::PilotSwitch };
    let law = LAWS[draw.below(LAWS.len())].id.to_owned();
    let trajectory = trajectory(draw);
    let clock_rate = if draw.chance(0.2) { rounded(draw.within([0.98, 1.02])) } else { 1.0 };
    let mut faults = Vec::new();
    if policy == EngagePolicy::PilotSwitch {
        let pilot = |at_s, act| Timed { at_s, for_s: 0.0, fault: Fault::Pilot { act } };
        faults.push(pilot(SWITCH_S, PilotAct::Offboard));
        faults.push(pilot(SWITCH_S + 0.3, PilotAct::Arm));
    }
    for _ in 0..1 + draw.below(FAULTS_MAX) {
        scene(draw, &mut faults);
    }
    for timed in &mut faults {
        (timed.at_s, timed.for_s) = (thousandth(timed.at_s), thousandth(timed.for_s));
    }
    let seed = draw.seed();
    // Drawn last, so that everything before is drawn as it was without signing.
    let signed = draw.chance(0.25);
    Script {
        schema_version: VERSION,
        // Shortened to an integer that TOML and JSON preserve.
        seed: seed >> 12,
        vehicle: vehicle.to_owned(),
        autopilot,
        law,
        policy,
        clock_rate,
        signed,
        trajectory,
        faults,
    }
}

fn thousandth(value: f64) -> f64 {
    (value * 1e3).round() * 1e-3
}

fn trajectory(draw: &mut Draw) -> String {
    let seconds = 2.0 + draw.below(4) as f64;
    match draw.below(5) {
        0 | 1 => format!("family = \"hover\"\naltitude_m = 1.0\nduration_s = {seconds:.1}\n"),
        2 => format!(
            "family = \"figure-8\"\naltitude_m = 1.0\nduration_s = {seconds:.1}\nlength_m = 1.5\n\
             width_m = 0.8\nperiod_s = 6.0\nclimb_m = 0.3\n"
        ),
        3 => format!(
            "family = \"sinusoid-yaw\"\naltitude_m = 1.0\nduration_s = {seconds:.1}\n\
             amplitude_m = 0.5\nperiod_s = 5.0\nyaw_period_s = 10.0\n"
        ),
        _ => "family = \"steps\"\naltitude_m = 1.0\ndwell_s = 1.5\n\
              offsets = [[0.5, 0.0, 0.0, 0.0], [0.0, 0.0, 0.3, 45.0]]\n"
            .to_owned(),
    }
}

/// Draws one fault, or several that belong together.
fn scene(draw: &mut Draw, faults: &mut Vec<Timed>) {
    let at_s = draw.within([0.5, FLIGHT_S]);
    // From a flicker to almost half the flight.
    let for_s = draw.log_within([0.03, 8.0]);
    let timed = |fault| Timed { at_s, for_s, fault };
    let pilot = |at_s, act| Timed { at_s, for_s: 0.0, fault: Fault::Pilot { act } };
    match draw.below(15) {
        0..=3 => faults.push(timed(link(draw))),
        4 => faults.push(timed(clock(draw))),
        5 | 6 => faults.push(timed(telemetry(draw))),
        7 | 8 => faults.push(timed(vehicle(draw))),
        9 => {
            let act = [
                PilotAct::Position,
                PilotAct::Hold,
                PilotAct::Return,
                PilotAct::Land,
                PilotAct::Disarm,
                PilotAct::Position,
                PilotAct::Hold,
                PilotAct::Kill,
            ][draw.below(8)];
            faults.push(pilot(at_s, act));
            // The pilot may switch back and forth.
            let mut next_s = at_s;
            while draw.chance(0.3) {
                next_s += draw.log_within([0.05, 3.0]);
                faults.push(pilot(next_s, PilotAct::Offboard));
                next_s += draw.log_within([0.05, 3.0]);
                faults.push(pilot(next_s, PilotAct::Position));
            }
        }
        10 => {
            // The pilot takes over unheard, and earlier frames are repeated afterwards.
            let silent_s = draw.within([0.55, 2.2]);
            faults.push(Timed { at_s, for_s: silent_s, fault: Fault::Cut { way: Way::Down } });
            let act = if draw.chance(0.5) { PilotAct::Position } else { PilotAct::Hold };
            faults.push(pilot(at_s + draw.within([0.0, silent_s]), act));
            let fault = Fault::Replay { age_s: silent_s + 0.5, rate_hz: 30.0 };
            faults.push(Timed { at_s: at_s + silent_s, for_s: 0.5, fault });
        }
        11 => {
            let for_s = draw.log_within([0.03, 2.5]);
            faults.push(Timed { at_s, for_s, fault: Fault::Pause });
            if draw.chance(0.3) {
                faults.push(pilot(at_s + draw.within([0.0, for_s]), PilotAct::Position));
            }
        }
        12 => {
            // The vehicle does not receive, or refuses, the request to land.
            let at_s = draw.within([11.0, 18.0]);
            let for_s = draw.within([2.0, 8.0]);
            let fault =
                if draw.chance(0.5) { Fault::Refusals } else { Fault::Cut { way: Way::Up } };
            faults.push(Timed { at_s, for_s, fault });
        }
        _ => faults.push(timed(process(draw))),
    }
}

fn way(draw: &mut Draw) -> Way {
    [Way::Down, Way::Up, Way::Both][draw.below(3)]
}

fn link(draw: &mut Draw) -> Fault {
    match draw.below(9) {
        0 => Fault::Loss { way: way(draw), share: rounded(draw.within([0.02, 0.9])) },
        1 => Fault::Cut { way: way(draw) },
        2 => Fault::ModeLost,
        3 => Fault::Delay {
            way: way(draw),
            least_s: rounded(draw.log_within([0.002, 0.6])),
            jitter_s: rounded(draw.log_within([0.001, 0.3])),
        },
        4 => Fault::Duplicates {
            share: rounded(draw.within([0.05, 1.0])),
            after_s: rounded(draw.log_within([0.001, 1.0])),
        },
        5 => Fault::Corruption { share: rounded(draw.within([0.02, 0.6])) },
        6 => Fault::Replay {
            age_s: rounded(draw.within([0.1, 5.0])),
            rate_hz: rounded(draw.log_within([2.0, 100.0])),
        },
        7 => Fault::Foreign { system: [1, 2, 42, 255][draw.below(4)] },
        _ => Fault::Injected {
            thrust: rounded(draw.within([0.0, 1.0])),
            pitch_rad: rounded(draw.within([-0.6, 0.6])),
        },
    }
}

fn clock(draw: &mut Draw) -> Fault {
    if draw.chance(0.3) {
        return Fault::ClockWrap;
    }
    Fault::ClockStep { by_s: rounded(draw.sign() * draw.log_within([0.01, 100.0])) }
}

fn telemetry(draw: &mut Draw) -> Fault {
    match draw.below(6) {
        0 => Fault::Freeze,
        1 | 2 => Fault::Jump {
            metres: rounded(draw.sign() * draw.log_within([0.05, 20.0])),
            is_told: draw.chance(0.5),
        },
        3 => Fault::NotANumber,
        4 => Fault::OldStamps { by_s: rounded(draw.log_within([0.02, 5.0])) },
        _ => Fault::OtherFrame,
    }
}

fn vehicle(draw: &mut Draw) -> Fault {
    match draw.below(7) {
        0 => Fault::Rotor { index: draw.below(4), loss: rounded(draw.within([0.05, 0.3])) },
        1 => Fault::Rotor { index: draw.below(4), loss: 1.0 },
        2 => Fault::Battery { charge: rounded(draw.within([0.0, 0.3])) },
        3 => Fault::Wind {
            share: rounded(draw.within([0.02, 0.3])),
            towards_rad: rounded(draw.within([-3.1, 3.1])),
        },
        4 => Fault::Dropped { share: rounded(draw.within([0.02, 0.25])) },
        5 => Fault::Reboot,
        _ => Fault::Refusals,
    }
}

fn process(draw: &mut Draw) -> Fault {
    match draw.below(6) {
        0 => Fault::Restart,
        1 => Fault::Jammed,
        2 => Fault::LogStuck,
        3 => Fault::PlannerStalls,
        4 => Fault::PlannerLies { metres: rounded(draw.sign() * draw.log_within([0.1, 100.0])) },
        _ => Fault::PlannerFails,
    }
}
