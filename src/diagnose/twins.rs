//! Twins: the flights as the simulator flies them, with noise of the sensors and no effect.
//!
//! A twin is a [`Replica`] of every flight that is fitted, of the vehicle with its nuisances, and
//! goes through the same analysis. What the simulator's noise does not account for in the flights'
//! residuals is drawn from its spectrum and put on top. The largest gain of evidence over the
//! catalogue, over many twins, is what an effect must exceed: it holds the multiple tests, the
//! noise that feedback puts into the outputs, and the excitation of these very flights.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::Serialize;
use sitl::vehicle::VehicleError;

use super::gap::ReportNoise;
use super::hypothesis::{Catalogue, Values};
use super::layout::Place;
use super::linearised::Linearised;
use super::noise::report_noise;
use super::observed::{Observed, Residuals};
use super::preparation::PreparedFlight;
use super::replica::Replica;
use super::selection::{Scored, Selector};

/// Share of twins that may exceed the threshold.
const EXCEEDED: f64 = 0.01;

/// What the twins say.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Twins {
    /// How many there were.
    pub count: u32,
    /// The largest gain of evidence of each, over what chance gives the hypothesis, ascending, nats.
    pub largest: Vec<f64>,
    /// What one in a hundred exceeds: beyond the largest by the twins' exponential tail.
    pub threshold: f64,
    /// Gain of evidence that half of the twins exceed, of each hypothesis of the catalogue: what a
    /// fit that is off by itself gives away.
    #[serde(skip)]
    pub chance: Vec<f64>,
}

/// Twins that are flown to find how far a fit is off by itself.
const PILOTS: u32 = 6;

/// Twins of flights, fitted as the flights were.
#[derive(Clone, Debug)]
pub struct TwinFits {
    /// The vehicle that they are of: one whose fits come out as that of the flights did.
    pub truth: Values,
    /// What each twin leaves at the values of the flights' fit.
    pub residuals: Vec<Residuals>,
    /// The values that each is fitted with.
    pub values: Vec<Values>,
    /// What is found as noise in their reports.
    noise: ReportNoise,
    /// The sum of squares that each fit leaves at each place.
    pub power: Vec<Vec<f64>>,
}

impl TwinFits {
    /// Flies twins of the vehicle that `about` was linearised about, and fits its nuisances and the
    /// numbers `active` to each. `noise`: what is found in the flights' reports. `draws`: how many
    /// twins, and a seed.
    ///
    /// A fit is off by itself: outputs that are logged less often than the loop ticks are noisy
    /// inputs, which makes an inertia look larger; and what is found as noise holds motion. Pilot
    /// twins tell by how much, and the twins are of a vehicle and of sensors that are found as the
    /// flights' were (indirect inference; Gourieroux, Monfort and Renault 1993).
    ///
    /// # Errors
    /// A vehicle that the physics refuses.
    pub fn draw(
        observed: &Observed<'_>,
        about: &Linearised,
        active: &[usize],
        noise: &ReportNoise,
        setpoint_leg: bool,
        (count, seed): (u32, u64),
    ) -> Result<Self, VehicleError> {
        let numbers = &observed.catalogue.numbers;
        let twins = |truth: Values, noise: &ReportNoise, count: u32, seed: u64| {
            Self::of(observed, about, truth, active, (noise, setpoint_leg), (count, seed))
        };
        let plain: Values = numbers
            .iter()
            .enumerate()
            .map(|(i, n)| if active.contains(&i) { about.values[i] } else { n.reference })
            .collect();
        let pilots = PILOTS.min(count);
        let found = twins(plain.clone(), noise, pilots, !seed)?.noise;
        let noise = noise.matched(&found);
        let bias = twins(plain, &noise, pilots, seed ^ 0xb1a5)?.bias(observed.catalogue);
        let truth = bias.iter().zip(&about.values).zip(numbers).map(|((bias, value), number)| {
            let [low, high] = number.bounds;
            (value - bias).clamp(low, high)
        });
        twins(truth.collect(), &noise, count, seed)
    }

    /// Twins where no on-board law is known to fly them by: the same motion with other noise, drawn
    /// from the spectrum of what `power` leaves.
    pub fn of_noise(observed: &Observed<'_>, power: &[f64], draws: (u32, u64)) -> Self {
        let (count, seed) = draws;
        let deviation: Vec<f64> =
            power.iter().zip(observed.counts()).map(|(q, n)| (q / n.max(1.0)).sqrt()).collect();
        let layouts = observed.layouts.iter();
        let still: Residuals = layouts.map(|layout| vec![0.0; layout.places.len()]).collect();
        let residuals: Vec<Residuals> = (0..count)
            .into_par_iter()
            .map(|twin| {
                let mut residuals = still.clone();
                add_noise(observed, &deviation, seed.wrapping_add(u64::from(twin)), &mut residuals);
                residuals
            })
            .collect();
        let power = residuals.iter().map(|residuals| observed.power(residuals)).collect();
        let truth = observed.catalogue.references();
        Self { truth, residuals, values: Vec::new(), noise: ReportNoise::default(), power }
    }

    fn of(
        observed: &Observed<'_>,
        about: &Linearised,
        truth: Values,
        active: &[usize],
        (noise, setpoint_leg): (&ReportNoise, bool),
        (count, seed): (u32, u64),
    ) -> Result<Self, VehicleError> {
        let onboard = observed.evaluator.onboard().filter(|_| setpoint_leg);
        let replica = Replica::new(observed.catalogue, &truth, noise, onboard)?;
        let mut twins = Self {
            truth,
            residuals: Vec::new(),
            values: Vec::new(),
            power: Vec::new(),
            noise: *noise,
        };
        let drawn: Vec<(Residuals, Values, Vec<f64>, ReportNoise)> = (0..count)
            .into_par_iter()
            .filter_map(|twin| {
                let seed = seed.wrapping_add(u64::from(twin) << 20);
                let flights: Vec<PreparedFlight> = observed
                    .flights
                    .iter()
                    .enumerate()
                    .map(|(index, flight)| replica.fly(flight, seed.wrapping_add(index as u64)))
                    .collect();
                let residuals = observed.like(&flights).residuals(&about.values)?;
                let about = about.about(observed, &residuals);
                let fit = about.solve(observed.catalogue, observed.counts(), active)?;
                let noise = report_noise(&flights, &fit.power, observed.counts());
                Some((residuals, fit.values, fit.power, noise))
            })
            .collect();
        twins.noise = ReportNoise::mean(drawn.iter().map(|(.., noise)| noise));
        for (residuals, values, power, _) in drawn {
            twins.residuals.push(residuals);
            twins.values.push(values);
            twins.power.push(power);
        }
        Ok(twins)
    }

    /// By how much fits are off the truth on average, of each number.
    pub fn bias(&self, catalogue: &Catalogue) -> Values {
        let n = self.values.len().max(1) as f64;
        (0..catalogue.numbers.len())
            .map(|i| self.values.iter().map(|values| values[i] - self.truth[i]).sum::<f64>() / n)
            .collect()
    }

    /// Standard deviation of the fits of one number.
    pub fn deviation(&self, number: usize) -> f64 {
        let n = self.values.len().max(1) as f64;
        let mean = self.values.iter().map(|values| values[number]).sum::<f64>() / n;
        let squares: f64 = self.values.iter().map(|values| (values[number] - mean).powi(2)).sum();
        (squares / (n - 1.0).max(1.0)).sqrt()
    }

    /// Mean and standard deviation of the sum of squares at each place.
    pub fn moments(&self) -> Vec<[f64; 2]> {
        let n = self.power.len().max(1) as f64;
        (0..Place::COUNT)
            .map(|place| {
                let mean = self.power.iter().map(|p| p[place]).sum::<f64>() / n;
                let squares = self.power.iter().map(|p| (p[place] - mean).powi(2)).sum::<f64>();
                [mean, (squares / (n - 1.0).max(1.0)).sqrt()]
            })
            .collect()
    }
}

/// Screens twins of the flights that are fitted; `null` is the fit of the nuisances alone.
pub fn screened(
    selector: &Selector<'_>,
    null: &Scored,
    about: &Linearised,
    twins: &TwinFits,
    seed: u64,
) -> Twins {
    let observed = selector.fitted;
    // Beyond the sensors' noise: turbulence, vibration, what the model lacks.
    let more: Vec<f64> = twins
        .moments()
        .iter()
        .zip(&null.fit.power)
        .zip(observed.counts())
        .map(|(([mean, _], found), n)| ((found - mean) / n.max(1.0)).max(0.0).sqrt())
        .collect();
    let count = twins.residuals.len() as u32;
    let gains: Vec<Vec<f64>> = twins
        .residuals
        .par_iter()
        .enumerate()
        .map(|(twin, residuals)| {
            let mut residuals = residuals.clone();
            add_noise(observed, &more, seed.wrapping_add((twin as u64) << 20), &mut residuals);
            let about = about.about(observed, &residuals);
            let mut gains = vec![0.0; selector.catalogue.hypotheses.len()];
            for (hypothesis, gain) in selector.screen(&about, &[]) {
                gains[hypothesis] = gain;
            }
            gains
        })
        .collect();
    let chance: Vec<f64> = (0..selector.catalogue.hypotheses.len())
        .map(|h| {
            let mut of_one: Vec<f64> = gains.iter().map(|gains| gains[h]).collect();
            of_one.sort_by(f64::total_cmp);
            of_one.get(of_one.len() / 2).map_or(0.0, |gain| gain.max(0.0))
        })
        .collect();
    let mut largest: Vec<f64> = gains
        .iter()
        .map(|gains| gains.iter().zip(&chance).map(|(gain, c)| gain - c).fold(0.0, f64::max))
        .collect();
    largest.sort_by(f64::total_cmp);
    let threshold = threshold(&largest);
    Twins { count, largest, threshold, chance }
}

/// Adds noise with a deviation at each place.
fn add_noise(observed: &Observed<'_>, deviation: &[f64], seed: u64, residuals: &mut Residuals) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    for (residuals, layout) in residuals.iter_mut().zip(&observed.layouts) {
        for (residual, place) in residuals.iter_mut().zip(&layout.places) {
            let z: f64 = StandardNormal.sample(&mut rng);
            *residual += z * deviation[place.index()];
        }
    }
}

/// The point that a share of [`EXCEEDED`] exceeds. The upper half of the maxima falls off
/// exponentially, and carries on so beyond the largest that was drawn.
fn threshold(largest: &[f64]) -> f64 {
    let n = largest.len();
    if n < 2 {
        return 0.0;
    }
    let median = largest[n / 2];
    let upper = &largest[n / 2..];
    let slope = upper.iter().map(|gain| gain - median).sum::<f64>() / upper.len() as f64;
    median + slope * (0.5 / EXCEEDED).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_threshold_of_exponential_maxima_is_their_hundredth() {
        let n = 2000;
        // Quantiles of an exponential distribution with mean 3.
        let largest: Vec<f64> =
            (0..n).map(|i| -3.0 * (1.0 - (f64::from(i) + 0.5) / f64::from(n)).ln()).collect();
        let expected = 3.0 * 100.0_f64.ln();
        assert!((threshold(&largest) / expected - 1.0).abs() < 0.02, "{}", threshold(&largest));
    }
}
