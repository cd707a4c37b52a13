//! Flies the simulated vehicle with a custom control law, and with one of downwash's for
//! comparison:
//!
//!     cargo run --example own_control_law

#[path = "fly_lockstep.rs"]
#[allow(dead_code, clippy::duplicate_mod, reason = "another example, which the tests fly as well")]
mod fly_lockstep;

use downwash::control::{
    Command, ControlLaw, ControlProblem, DesignError, Gain, Law, LawSpec, Reach,
};
use downwash::setpoint::{Reference, Setpoint, State};
use downwash::station::End;
use vehicle::frame::{Euler, Frd, Ned};

/// The law's entry, as in a table of laws.
static PID: LawSpec = LawSpec {
    id: "pid",
    summary: "PID of the position, small angles.",
    gains: &[Gain {
        key: "gains.integral_per_s3",
        unit: "1/s^3",
        values: 1,
        meaning: "acceleration over the integral of the position error",
    }],
    design: |problem| Ok(Box::new(Pid::design(problem)?)),
};

/// Natural frequency of the position, rad/s.
const BANDWIDTH: f64 = 2.0;
/// The largest integral of the position error, m s.
const INTEGRAL_MAX: f64 = 1.0;

/// `a = -wn^2 e - 2 wn v - ki (integral of e)`, as thrust and small angles.
#[derive(Clone, Debug)]
struct Pid {
    mass_kg: f64,
    gravity: f64,
    reach: Reach,
    integral_per_s3: f64,
    integral: Ned,
}

impl Pid {
    fn design(problem: &ControlProblem) -> Result<Self, DesignError> {
        let [integral_per_s3] = problem.settings.gains.get("integral_per_s3").unwrap_or([1.5]);
        Ok(Self {
            mass_kg: problem.vehicle.mass_kg,
            gravity: problem.vehicle.gravity,
            reach: problem.settings.into(),
            integral_per_s3,
            integral: Ned::zero(),
        })
    }
}

impl ControlLaw for Pid {
    fn command(&mut self, state: &State, reference: &Reference, dt_s: f64) -> Command {
        let (error, is_cut) = self.reach.bounded(state.position - reference.position);
        let sum = self.integral + error * dt_s;
        self.integral = sum * (INTEGRAL_MAX / sum.norm()).min(1.0);
        let acceleration = error * -BANDWIDTH.powi(2)
            - (state.velocity - reference.velocity) * (2.0 * BANDWIDTH)
            - self.integral * self.integral_per_s3;
        let (sin, cos) = state.attitude.yaw().sin_cos();
        let [north, east, down] = acceleration.to_array();
        let (ahead, right) = (cos * north + sin * east, cos * east - sin * north);
        // Nose down accelerates ahead, right side down to the right.
        let feedback = Setpoint {
            thrust_n: -self.mass_kg * down,
            attitude: Euler::new(right / self.gravity, -ahead / self.gravity, 0.0),
            body_rate: Frd::zero(),
        };
        Command::correcting(reference, feedback, is_cut)
    }

    fn reset(&mut self) {
        self.integral = Ned::zero();
    }
}

/// Flies under the LQR and under this law, with rotors that produce a tenth less thrust than
/// assumed; returns how each flight ended and its RMS distance from the trajectory, m.
pub fn compare() -> anyhow::Result<[(End, f64); 2]> {
    let effect = "thrust_scale:scale=0.9";
    Ok([fly_lockstep::fly(effect, Law::LQR)?, fly_lockstep::fly(effect, Law::new(&PID))?])
}

fn main() -> anyhow::Result<()> {
    let [(lqr, lqr_m), (pid, pid_m)] = compare()?;
    println!("lqr: {lqr:?}, {lqr_m:.3} m RMS from the trajectory");
    println!("pid: {pid:?}, {pid_m:.3} m RMS from the trajectory");
    Ok(())
}
