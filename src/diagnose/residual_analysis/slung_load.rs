//! Whether an unexplained force swings like a load on a line.
//!
//! A load that hangs from the vehicle is a pendulum that the vehicle's motion drives. With the
//! load's horizontal offset q and the vehicle's velocity v, `q'' + 2 zeta omega q' + omega^2 q =
//! -v'`, and the line pulls the vehicle by `m omega^2 q`. Gusts push whatever the vehicle does; this
//! force follows from its motion.

use crate::diagnose::residual_analysis::map::Sample;

/// Angular frequencies, rad/s: lines of 0.2 to 2.5 m, each within 3 % of one of them, which is less
/// than the width of a resonance at the least damping.
const OMEGA_MIN_RAD_S: f64 = 2.0;
const OMEGA_RATIO: f64 = 1.06;
const OMEGAS: usize = 22;
/// Damping ratios zeta.
const DAMPINGS: [f64; 5] = [0.02, 0.035, 0.06, 0.1, 0.2];
/// Integration step, s.
const STEP_S: f64 = 0.01;
/// Longest time between samples over which the pendulum swings on, s; it hangs at rest after it.
const PAUSE_S: f64 = 0.6;
/// Least number of samples.
const SAMPLES_MIN: usize = 40;

/// Share, 0 to 1, of the power of the horizontal unexplained force of `samples` that the pull of one
/// load explains: of whatever mass, on whatever line. 0 if there are too few samples.
pub fn slung_load(samples: &[Sample]) -> f64 {
    let pushes: Vec<Push> = samples.iter().map(Push::from).collect();
    largest_share(&pushes)
}

/// The horizontal motion and the unexplained force at one time.
#[derive(Clone, Copy, Debug)]
struct Push {
    /// Time in the flight, s.
    time: f64,
    /// Velocity along north and east, m/s.
    velocity: [f64; 2],
    /// Unexplained acceleration along north and east, m/s^2.
    force: [f64; 2],
}

impl From<&Sample> for Push {
    fn from(sample: &Sample) -> Self {
        let [velocity, force] =
            [sample.velocity, sample.world].map(|[north, east, _]| [north, east]);
        Self { time: sample.time(), velocity, force }
    }
}

fn largest_share(pushes: &[Push]) -> f64 {
    if pushes.len() < SAMPLES_MIN {
        return 0.0;
    }
    let omegas = (0..OMEGAS).map(|k| OMEGA_MIN_RAD_S * OMEGA_RATIO.powi(k as i32));
    let pendulums = omegas.flat_map(|omega| DAMPINGS.map(|zeta| Pendulum { omega, zeta }));
    pendulums.map(|pendulum| pendulum.share(pushes)).fold(0.0, f64::max)
}

/// A pendulum of angular frequency `omega`, rad/s, and damping ratio `zeta`.
#[derive(Clone, Copy, Debug)]
struct Pendulum {
    omega: f64,
    zeta: f64,
}

impl Pendulum {
    /// Share of the force that the pull of a load on this pendulum explains.
    fn share(self, pushes: &[Push]) -> f64 {
        let pulls = self.pulls(pushes);
        let n = pushes.len() as f64;
        let (mut product, mut pull, mut force) = (0.0, 0.0, 0.0);
        for axis in 0..2 {
            let pull_mean = pulls.iter().map(|pull| pull[axis]).sum::<f64>() / n;
            let force_mean = pushes.iter().map(|push| push.force[axis]).sum::<f64>() / n;
            for (own, push) in pulls.iter().zip(pushes) {
                let (own, felt) = (own[axis] - pull_mean, push.force[axis] - force_mean);
                product += own * felt;
                pull += own * own;
                force += felt * felt;
            }
        }
        // A load pulls, and never pushes: its mass is positive.
        let is_pull = product > 0.0 && pull > 0.0 && force > 0.0;
        if is_pull { product * product / (pull * force) } else { 0.0 }
    }

    /// `omega^2 q` along north and east at each sample, m/s^2: the pull over the load's mass.
    fn pulls(self, pushes: &[Push]) -> Vec<[f64; 2]> {
        let mut swing = [Swing::default(); 2];
        let mut before: Option<&Push> = None;
        let mut pulls = Vec::with_capacity(pushes.len());
        for push in pushes {
            let before = before.replace(push).unwrap_or(push);
            let since = push.time - before.time;
            for (axis, swing) in swing.iter_mut().enumerate() {
                let change = push.velocity[axis] - before.velocity[axis];
                if (0.0..PAUSE_S).contains(&since) {
                    self.swing_on(swing, change, since);
                } else {
                    *swing = Swing::default();
                }
            }
            pulls.push(swing.map(|swing| self.omega * self.omega * swing.offset));
        }
        pulls
    }

    /// Advances by `time` seconds, in which the vehicle's velocity changes evenly by `change`.
    fn swing_on(self, swing: &mut Swing, change: f64, time: f64) {
        let steps = (time / STEP_S).ceil().max(1.0);
        let step = time / steps;
        let acceleration = change / time.max(f64::MIN_POSITIVE);
        for _ in 0..steps as usize {
            let Pendulum { omega, zeta } = self;
            let restoring = 2.0 * zeta * omega * swing.rate + omega * omega * swing.offset;
            swing.rate -= step * (acceleration + restoring);
            swing.offset += step * swing.rate;
        }
    }
}

/// A load's horizontal offset along one axis.
#[derive(Clone, Copy, Debug, Default)]
struct Swing {
    /// q, m.
    offset: f64,
    /// q', m/s.
    rate: f64,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const GRAVITY: f64 = 9.81;

    /// A load's line, m, and its mass over the vehicle's.
    #[derive(Clone, Copy, Debug)]
    struct Load {
        length_m: f64,
        mass_ratio: f64,
    }

    /// A minute of flight under position feedback at natural frequency 1.5 rad/s along a path, with
    /// a force: a load's, or an independent one with this correlation time, s.
    struct Flight {
        load: Option<Load>,
        gust_s: f64,
        path_m: f64,
        seed: u64,
    }

    impl Flight {
        fn pushes(&self) -> Vec<Push> {
            let mut rng = Pcg64Mcg::seed_from_u64(self.seed);
            let mut pushes = Vec::new();
            let (mut place, mut velocity) = ([0.0_f64; 2], [0.0_f64; 2]);
            let (mut swing, mut gust) = ([Swing::default(); 2], [0.0_f64; 2]);
            let phase: [f64; 2] = [rng.random_range(0.0..6.0), rng.random_range(0.0..6.0)];
            for k in 0..6000 {
                let time = f64::from(k) * STEP_S;
                let mut force = [0.0; 2];
                for axis in 0..2 {
                    let reference = |t: f64| {
                        let slow = (1.26 * t + phase[axis]).sin();
                        self.path_m * (slow + 0.4 * (2.9 * t + phase[1 - axis]).sin())
                    };
                    let wish = reference(time);
                    let rate = (reference(time + 1e-4) - reference(time - 1e-4)) / 2e-4;
                    let feedback = 2.25 * (wish - place[axis]) + 2.1 * (rate - velocity[axis]);
                    force[axis] = match self.load {
                        Some(load) => {
                            load.mass_ratio * GRAVITY / load.length_m * swing[axis].offset
                        }
                        None => {
                            let kick: f64 = rng.sample(StandardNormal);
                            gust[axis] += -gust[axis] * STEP_S / self.gust_s
                                + kick * 0.4 * (2.0 * STEP_S / self.gust_s).sqrt();
                            gust[axis]
                        }
                    };
                    let acceleration = feedback + force[axis];
                    if let Some(load) = self.load {
                        let omega = (GRAVITY / load.length_m).sqrt();
                        let pendulum = Pendulum { omega, zeta: 0.05 };
                        pendulum.swing_on(&mut swing[axis], acceleration * STEP_S, STEP_S);
                    }
                    velocity[axis] += acceleration * STEP_S;
                    place[axis] += velocity[axis] * STEP_S;
                }
                if k % 25 == 12 {
                    let noisy = force.map(|f| f + 0.05 * rng.sample::<f64, _>(StandardNormal));
                    pushes.push(Push { time, velocity, force: noisy });
                }
            }
            pushes
        }

        fn share(&self) -> f64 {
            largest_share(&self.pushes())
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn swinging_load_explains_its_pull(
            length_m in 0.3..1.5, mass_ratio in 0.1..0.6, path_m in 0.3..1.5, seed: u64,
        ) {
            let load = Load { length_m, mass_ratio };
            let share = Flight { load: Some(load), gust_s: 1.0, path_m, seed }.share();
            prop_assert!(share > 0.6, "{share}");
        }

        #[test]
        fn gusts_are_no_load(gust_s in 0.3..5.0, path_m in 0.3..1.5, seed: u64) {
            let share = Flight { load: None, gust_s, path_m, seed }.share();
            prop_assert!(share < 0.3, "{share}");
        }
    }

    #[test]
    fn few_samples_show_no_load() {
        let load = Load { length_m: 0.6, mass_ratio: 0.3 };
        let mut pushes = Flight { load: Some(load), gust_s: 1.0, path_m: 1.0, seed: 1 }.pushes();
        pushes.truncate(SAMPLES_MIN - 1);
        assert_eq!(largest_share(&pushes), 0.0);
    }
}
