//! The verdict: whether what was named explains what was seen.
//!
//! A force or a moment that is left counts if it is more than chance leaves and of practical size:
//! if, within the time that a planner looks ahead, it moves the vehicle by more than the reports
//! are uncertain. Both are told in that unit, so that forces and moments can be compared.

use serde::Serialize;
use sitl::vehicle::VehicleParams;

use super::answer::{FlightAnswer, Gap};
use super::gap::OverNoise;
use super::layout::Place;
use super::leftover::{UnmodelledForce, UnmodelledMoment};
use super::misfit::{Misfit, share_left};
use super::noise::ReportNoise;
use super::observed::Observed;
use super::residuals::{RATE, VELOCITY};
use super::selection::Selection;
use super::spectrum::{BANDS, mean_square_share};

/// Time over which a force is compared with the velocity's noise, s.
const FORCE_TIME_S: f64 = 0.5;
/// A smaller force matters to nobody, in units of the weight.
const FORCE_MIN_WEIGHTS: f64 = 0.01;
/// Standard errors by which what is left must stand out.
pub(super) const SIGNIFICANCE: f64 = 5.0;
/// Share of what is unmodelled, in power, that effects may leave and still be the explanation.
const LEFT_MAX: f64 = 0.3;

/// The same of the evidence: of what could be explained in the equations that the effects answer
/// for.
const EVIDENCE_LEFT_MAX: f64 = 0.3;

/// Why what was seen counts as unexplained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unexplained {
    /// A force or a moment is left that outweighs what is explained.
    Leftover,
    /// The explanation leaves too much of the evidence: it is a neighbour of the cause.
    Neighbour,
    /// The gap on the flights held out stays open.
    OpenGap,
    /// With no effect found, one of the flights shows an open gap by itself.
    OpenOnOne,
    /// What was named predicts well only beside numbers of the vehicle file that are off, though by
    /// no more than files are.
    Propped,
    /// A number of what was named would have to vary with how the vehicle flies, which that effect's
    /// does not: something stands behind it that goes by the same quantity.
    Varies,
    /// What is left of the evidence and of the gap is too little to say so by itself, and together
    /// too much: the explanation is less likely than not to be the cause.
    Doubt,
    /// With no effect found, some equations leave more than the vehicle's own noise would.
    Misfit,
    /// With no effect found, numbers of the vehicle file must be further off than files are.
    Strain,
}

/// Something unmodelled in units of what matters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Size {
    /// What is left after the best explanation; 0 where it may be chance.
    pub left: f64,
    /// What the explanation explains.
    pub explained: f64,
}

/// What is left of forces and moments against what is explained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Balance {
    /// Force per mass.
    pub force: Size,
    /// Moments.
    pub moment: Size,
}

/// What is left of forces and moments.
#[derive(Clone, Debug)]
pub struct Leftover {
    /// Force before and after the best explanation, where two sensors see it.
    pub force: Option<[UnmodelledForce; 2]>,
    /// Moment before and after, where the on-board law is known.
    pub moment: Option<[UnmodelledMoment; 2]>,
}

impl Leftover {
    /// The force in units of what matters.
    pub fn force_size(&self, vehicle: &VehicleParams, noise: &ReportNoise, explained: f64) -> Size {
        // Over the time, the difference of two noisy velocities; three axes.
        let unit = (6.0_f64.sqrt() * noise.velocity / FORCE_TIME_S)
            .max(FORCE_MIN_WEIGHTS * vehicle.gravity);
        let after = self.force.as_ref().map(|[_, after]| after);
        let left = after.filter(|force| force.significance() > SIGNIFICANCE);
        Size {
            left: left.map_or(0.0, |force| force.rms() / unit),
            explained: explained.max(0.0).sqrt() / unit,
        }
    }

    /// The moment in units of what matters: the attitude or the body rate that it holds the vehicle
    /// off its setpoint by, against the on-board loop, over their noise.
    pub fn moment_size(
        &self,
        vehicle: &VehicleParams,
        noise: &ReportNoise,
        explained: [f64; 3],
    ) -> Size {
        let Some(pd) = vehicle.attitude_pd else { return Size::default() };
        let size = |angular_acceleration: [f64; 3]| -> f64 {
            let gains = pd.kp.into_iter().zip(pd.kd);
            let off = angular_acceleration.into_iter().zip(vehicle.inertia).zip(gains).map(
                |((acceleration, inertia), (kp, kd))| {
                    let moment = inertia * acceleration;
                    let attitude = moment / (kp * noise.attitude).max(f64::MIN_POSITIVE);
                    attitude.max(moment / (kd * noise.body_rate).max(f64::MIN_POSITIVE))
                },
            );
            (off.map(|off| off * off).sum::<f64>() / 3.0).sqrt()
        };
        let after = self.moment.as_ref().map(|[_, after]| after);
        let left = after.filter(|moment| moment.significance() > SIGNIFICANCE);
        Size {
            left: left.map_or(0.0, |moment| size(moment.rms())),
            explained: size(explained.map(|square| square.max(0.0).sqrt())),
        }
    }
}

/// Whether what is left outweighs what is explained: of practical size, and more than a share of
/// the whole.
pub fn is_unexplained(Balance { force, moment }: &Balance, found: bool) -> bool {
    let left = force.left.max(moment.left);
    let explained = if found { force.explained.max(moment.explained) } else { 0.0 };
    left > 1.0 && left.powi(2) > LEFT_MAX * (left.powi(2) + explained.powi(2))
}

/// Whether the explanation leaves too much of what could be explained to be the cause.
pub fn is_neighbour(misfits: &[Misfit]) -> bool {
    share_left(misfits) > EVIDENCE_LEFT_MAX
}

/// A gap on the flights held out that is worth an explanation, in units of the noise: predictions
/// of vehicles without one mostly stay within a tenth of what noise alone leaves; of three hundred
/// of an exam none lay above 1.16 but one whose noise scatters.
const GAP_MIN: f64 = 1.15;
/// The same of the worst of all flights by themselves: of 2400 flights without a gap one lay at
/// 1.32, and none other above 1.28.
const GAP_MIN_OF_ONE: f64 = 1.26;
/// Beyond it, in units of the scatter by noise alone.
const GAP_SCATTERS: f64 = 4.0;
/// Share of a gap that effects must close to be its explanation.
pub(super) const CLOSED_MIN: f64 = 0.5;

/// Whether the gap stays open on the flights held out: with the effects, and with the nuisances as
/// well. Where no effect is found, the gap is as open as it was: nuisances that would close it are
/// numbers of the file that are off, though by no more than files are, and no explanation.
pub fn is_open(gap: &Gap, found: bool) -> bool {
    let least = GAP_MIN + GAP_SCATTERS * gap.scatter;
    if !found {
        return gap.before > least * gap.floor;
    }
    gap.open() > least && gap.closure.unwrap_or(0.0) < CLOSED_MIN
}

/// The same of the body rate by itself, as shipped. Of 120 vehicles without an effect two had more:
/// alone it is no verdict, and what is named must close it.
const RATE_MIN: f64 = 1.12;

/// Whether the simulator as shipped predicts the body rate visibly worse than noise alone would.
/// The metric leaves it out, and it shows what is short: a lag is over before a position tells.
pub fn is_rate_off(gap: &Gap) -> bool {
    let [shipped, _, floor] = &gap.errors;
    shipped.rates_over(floor) > RATE_MIN + GAP_SCATTERS * gap.scatter
}

/// Whether the simulator as shipped leaves an open gap on any one of the flights: where nothing was
/// fitted, those of the fit may show it as well.
pub fn is_open_on_one(flights: &[FlightAnswer]) -> bool {
    flights.iter().filter_map(|flight| flight.over_noise).any(|over| is_open_alone(&over))
}

/// Whether the gap on one flight by itself is open.
pub(super) fn is_open_alone(over: &OverNoise) -> bool {
    over.gap > GAP_MIN_OF_ONE + GAP_SCATTERS * over.scatter
}

/// What nuisances must close beside the effects to count, in units of the noise.
const PROPS_MIN: f64 = 0.05;
/// Share of what effects and nuisances close together that effects must close by themselves. In two
/// exams those that acted closed 0.89 of it or more, and neighbours of what the catalogue lacked
/// 0.30 to 0.70.
const OWN_SHARE_MIN: f64 = 0.8;

/// Whether nuisances do a good part of the work of the effects' cause.
pub fn is_propped(gap: &Gap) -> bool {
    let Some(with) = gap.with_nuisances else { return false };
    let props = gap.after - with;
    let own = gap.before - gap.after;
    props > PROPS_MIN * gap.floor && own < OWN_SHARE_MIN * (own + props)
}

/// Mean square that the chosen effects explain and the nuisances do not: of the acceleration,
/// m^2/s^4, and of the angular acceleration about each axis, rad^2/s^4.
pub fn explained(selection: &Selection, observed: &Observed<'_>) -> (f64, [f64; 3]) {
    let counts = observed.counts();
    let (null, best) = (selection.null.fit.noise(counts), selection.best.fit.noise(counts));
    let of_channel = |channel: usize| -> f64 {
        (0..BANDS.len())
            .map(|band| {
                let place = Place::index_of(channel, band);
                (null[place] - best[place]) * mean_square_share(band)
            })
            .sum()
    };
    let force = (VELOCITY..VELOCITY + 3).map(of_channel).sum();
    (force, std::array::from_fn(|axis| of_channel(RATE + axis)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::gap::Errors;

    /// A gap by its metric as shipped, with the effects and with the nuisances as well.
    fn gap([before, after, with]: [f64; 3], floor: f64) -> Gap {
        Gap {
            metric: "mean",
            before,
            after,
            floor,
            scatter: 0.01,
            closure: None,
            nuisances_only: None,
            with_nuisances: Some(with),
            with_learner: None,
            errors: [Errors([[1.0; 4]; 3]); 3],
            noise: ReportNoise::default(),
        }
    }

    #[test]
    fn effects_that_need_nuisances_for_a_good_part_of_it_are_propped() {
        let is_propped = |metric| is_propped(&gap(metric, 2.0));
        assert!(is_propped([2.5, 2.22, 2.08]));
        // By as much, but of far more.
        assert!(!is_propped([6.0, 2.22, 2.08]));
        // What noise may do, or nuisances that make it worse.
        assert!(!is_propped([2.2, 2.16, 2.08]));
        assert!(!is_propped([2.2, 2.1, 2.3]));
    }

    #[test]
    fn a_body_rate_that_is_off_shows_where_the_metric_does_not() {
        let noise = Errors([[0.1, 0.1, 0.01, 0.05]; 3]);
        let with_rate = |rate: f64| {
            let mut shipped = noise;
            shipped.0.iter_mut().for_each(|quantities| quantities[3] *= rate);
            let before = shipped.mean_over(&noise);
            Gap { errors: [shipped, noise, noise], ..gap([before, 1.0, 1.0], 1.0) }
        };
        assert!(is_rate_off(&with_rate(1.3)) && !is_open(&with_rate(1.3), false));
        assert!(!is_rate_off(&with_rate(1.1)));
    }

    #[test]
    fn what_is_left_must_matter_and_outweigh_what_is_explained() {
        let none = Size::default();
        let force = |left, explained| Balance { force: Size { left, explained }, moment: none };
        assert!(!is_unexplained(&force(0.9, 0.0), false));
        assert!(is_unexplained(&force(1.1, 0.0), false));
        let moment = Balance { force: none, moment: Size { left: 1.1, explained: 0.0 } };
        assert!(is_unexplained(&moment, false));
        assert!(!is_unexplained(&force(1.1, 9.0), true));
        assert!(is_unexplained(&force(8.0, 9.0), true));
        // Nothing was found: what a larger model would explain does not count.
        assert!(is_unexplained(&force(1.1, 9.0), false));
    }
}
