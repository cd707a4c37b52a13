//! The step of a block of vehicles, compiled once for each vector instruction set.

use super::lane::{Lane, Real};
use super::motion::{Held, LANES, Model, Motion};
use crate::frame::{Frd, Ned};
use crate::physics::{BodyLaws, Environment, Loads, Physics};
use crate::plant::Plant;
use crate::rigid_body::{RightHandSide, Stage, State, rk4};

/// Vector instruction sets that the step is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// The instructions that every processor of the target has.
    Baseline,
    /// AVX2: eight single-precision numbers at once.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512: sixteen single-precision numbers at once.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Width {
    /// The widest set that this processor supports.
    pub fn of_this_processor() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            let has_512 = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512bw");
            if has_512 {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") {
                return Self::Avx2;
            }
        }
        Self::Baseline
    }

    /// The sets that this processor supports, narrowest first.
    pub fn available() -> Vec<Self> {
        let all = [
            Self::Baseline,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512,
        ];
        all.into_iter().filter(|width| *width <= Self::of_this_processor()).collect()
    }

    /// The set's name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "AVX2",
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "AVX-512",
        }
    }
}

/// A precision in which blocks can be stepped.
pub trait Precision: Real {
    /// Advances every lane by one step, without contact with the floor.
    fn step(width: Width, motion: &mut Motion<Self>, held: &Held<Self>, model: &Model);
}

/// Compiles the step in this crate, once for each precision and width.
macro_rules! precisions {
    ($($real:ty: $avx2:ident $avx512:ident;)*) => {$(
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2")]
        fn $avx2(motion: &mut Motion<$real>, held: &Held<$real>, model: &Model) {
            step(motion, held, model);
        }

        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
        fn $avx512(motion: &mut Motion<$real>, held: &Held<$real>, model: &Model) {
            step(motion, held, model);
        }

        impl Precision for $real {
            #[allow(unsafe_code, reason = "a width is one that this processor has")]
            fn step(width: Width, motion: &mut Motion<Self>, held: &Held<Self>, model: &Model) {
                match width {
                    Width::Baseline => step(motion, held, model),
                    #[cfg(target_arch = "x86_64")]
                    Width::Avx2 => unsafe { $avx2(motion, held, model) },
                    #[cfg(target_arch = "x86_64")]
                    Width::Avx512 => unsafe { $avx512(motion, held, model) },
                }
            }
        }
    )*};
}
precisions! {
    f32: step_f32_avx2 step_f32_avx512;
    f64: step_f64_avx2 step_f64_avx512;
}

#[inline(always)]
fn step<F: Real>(motion: &mut Motion<F>, held: &Held<F>, model: &Model) {
    if model.physics.is_bare() {
        step_lanes(motion, held, model, &model.physics.bare());
    } else if let Some(physics) = model.physics.lawful() {
        step_lanes(motion, held, model, &physics);
    } else {
        step_lanes(motion, held, model, &model.physics.dense());
    }
}

/// `physics` is the model's, in the form that suits its effects: the loop does not compute terms
/// that are unused.
#[inline(always)]
fn step_lanes<F: Real, L: BodyLaws>(
    motion: &mut Motion<F>,
    held: &Held<F>,
    model: &Model,
    physics: &Physics<L>,
) {
    let is_sudden = model.lag.is_none();
    for lane in 0..LANES {
        let environment = Environment {
            air_velocity: Ned::from(held.air_velocity.each_ref().map(|v| v[lane].to_f64())),
            voltage_factor: held.voltage_factor[lane].to_f64(),
            floor: model.floor_down,
            voltage: held.voltage[lane].to_f64(),
            time: held.time,
        };
        let outputs = held.outputs.each_ref().map(|values| Lane(values[lane]));
        let rotors = motion.rotors(lane);
        let start = physics.loads(&rotors, &environment);
        let [middle, end] = model.lag.advance(&rotors, &outputs);
        let end_loads = physics.loads(&end, &environment);
        let loads = if is_sudden {
            physics.sudden_loads(start, end_loads, Plant::STEP)
        } else {
            let middle = physics.loads(&middle, &environment);
            physics.lagged_loads([start, middle, end_loads], Plant::STEP)
        };
        let flight = Flight { physics, loads, environment };
        let state = rk4(&motion.state(lane), Plant::STEP, flight);
        motion.set_state(lane, &state);
        motion.set_rotors(lane, end);
    }
}

/// The right-hand side of a vehicle in free flight over a step.
struct Flight<'a, F, L> {
    physics: &'a Physics<L>,
    loads: [Loads<Lane<F>>; 3],
    environment: Environment,
}

impl<F: Real, L: BodyLaws> RightHandSide<Lane<F>> for Flight<'_, F, L> {
    #[inline(always)]
    fn at(&mut self, state: &State<Lane<F>>, stage: Stage) -> (Ned<Lane<F>>, Frd<Lane<F>>) {
        let loads = &self.loads[stage.index()];
        self.physics.accelerations_under(state, loads, &self.environment)
    }
}
