//! Twins: the flights as a vehicle of known numbers flies them, with noise of its sensors.
//!
//! A twin is a [`Replica`] of every flight that is fitted, and goes through the same analysis. Of
//! the vehicle with its nuisances alone, what a hypothesis gains of evidence in hardly any of many
//! twins is what it must exceed: it holds the multiple tests, the noise that feedback puts into the
//! outputs, and the excitation of these very flights. Of the vehicle with the effects that were
//! chosen, twins tell what their fit is off by and how it scatters. Where no on-board law is known,
//! twins are the same motion with other noise, of the spectrum of what the flights leave.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleError;

use crate::diagnose::catalogue::hypothesis::Values;
use crate::diagnose::catalogue::number::Number;
use crate::diagnose::flights::onboard::OnboardLaw;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::fit::Z90;
use crate::diagnose::likelihood::layout::Place;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::noise::{ReportNoise, report_noise};
use crate::diagnose::likelihood::observed::{Observed, Residuals};
use crate::diagnose::search::Search;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::simulate::replica::Replica;

/// Least evidence beyond chance that counts as more than chance, nats.
const CHANCE_MIN: f64 = 3.0;
/// Share of twins in which any hypothesis may reach its threshold.
const EXCEEDED: f64 = 0.01;

/// What the twins say.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Twins {
    /// How many there were.
    pub count: u32,
    /// The largest gain of evidence of each, over its hypothesis' threshold, ascending.
    pub largest: Vec<f64>,
    /// Gain of evidence that half of the twins exceed, of each hypothesis of the catalogue: what a
    /// fit that is off by itself gives away, nats.
    #[serde(skip)]
    pub chance: Vec<f64>,
    /// Threshold of the gain beyond that of each hypothesis, nats. One that scatters from twin to
    /// twin is asked for more; the others are not.
    #[serde(skip)]
    pub asked: Vec<f64>,
}

/// Twins that are flown to find what is found as noise, and how far a fit is off by itself.
const PILOTS: [u32; 2] = [6, 10];
/// Of these so many tell how noisy derivatives are.
const PROBES: u32 = 2;
/// Mixed into the seed of the second pilots, whose noise is not to be the twins'.
const OF_BIAS: u64 = 0xb1a5;
/// Share of noise in a derivative's square from which on each twin has its own: flights that go
/// about have 0.01 to 0.5 in those by a lag, a delay of the outputs, a latency and an inertia, and
/// mostly below 0.008 in all others; a hover has 0.1 to 1 in those of the moments.
const NOISY: f64 = 0.01;

/// Numbers scatter more than twins': of 1260 of two exams and a round trip 87 % lay within what would
/// be 90 % intervals without it.
const BEYOND_TWINS: f64 = 1.08;

/// Nuisances of a vehicle without an effect lie within so many tolerances.
const TRUTH_WITHIN: f64 = 1.5;

/// Twins of flights, fitted as the flights were.
#[derive(Clone, Debug)]
pub struct TwinFits {
    /// The vehicle that they are of: the flights', as far as their fit and what it is off by itself
    /// tell.
    pub truth: Values,
    /// Noise of their sensors: that which is found as the flights' was.
    pub sensors: ReportNoise,
    /// By how much fits of pilots, whose nuisances are as expected, were off the truth on average,
    /// each number. A prior that draws nuisances to where they are expected is no such fault: where
    /// the flights' nuisances lie elsewhere, only the flights' fit can tell.
    pub bias: Values,
    /// Number of those pilots.
    pilots: u32,
    /// Numbers whose derivatives are noisy: those of the flights are not the twins'.
    pub noisy: Vec<usize>,
    /// The values that each is fitted with.
    pub values: Vec<Values>,
    /// The sum of squares that each fit leaves at each place.
    pub power: Vec<Vec<f64>>,
    /// What chance is read off.
    screened: Vec<Screened>,
}

/// A twin at the values of the flights' fit.
#[derive(Clone, Debug)]
struct Screened {
    /// What it leaves.
    residuals: Residuals,
    /// Its derivatives by the numbers whose derivatives are noisy.
    own: Vec<(usize, Residuals)>,
}

/// A twin, analysed as the flights were.
struct Twin {
    screened: Screened,
    values: Values,
    power: Vec<f64>,
    noise: ReportNoise,
}

/// How twins are flown and analysed.
struct Analysis<'a> {
    observed: &'a Observed<'a>,
    /// Where the flights were linearised.
    about: &'a Linearised,
    /// Numbers of the effects that are fitted.
    active: &'a [usize],
    onboard: &'a OnboardLaw,
    /// Numbers whose derivatives are noisy.
    noisy: Vec<usize>,
}

impl<'a> Analysis<'a> {
    /// The analysis, and the first of the pilots: twins whose nuisances are as expected, with
    /// sensors of `noise`.
    fn with_pilots(
        observed: &'a Observed<'a>,
        about: &'a Linearised,
        active: &'a [usize],
        onboard: &'a OnboardLaw,
        noise: &ReportNoise,
        (count, seed): (u32, u64),
    ) -> Result<(Self, Vec<Twin>), VehicleError> {
        let mut analysis = Self { observed, about, active, onboard, noisy: Vec::new() };
        let replica = analysis.replica(&analysis.plain(), noise)?;
        let probes: Vec<Vec<PreparedFlight>> = (0..PROBES)
            .into_par_iter()
            .map(|pilot| analysis.flown(&replica, seed, pilot))
            .collect();
        let [one, other] = &probes[..] else { return Ok((analysis, Vec::new())) };
        let shares = about.noise_shares([&observed.like(one), &observed.like(other)]);
        let noisy = shares.into_iter().filter(|(_, share)| *share > NOISY);
        analysis.noisy = noisy.map(|(number, _)| number).collect();
        let probes = probes.par_iter().filter_map(|flights| analysis.twin(flights));
        let others = (PROBES..count).into_par_iter().filter(|_| !observed.is_stopped());
        let others = others.filter_map(|p| analysis.twin(&analysis.flown(&replica, seed, p)));
        let pilots = probes.chain(others).collect();
        Ok((analysis, pilots))
    }

    /// The vehicle with the effects that were found, its nuisances as expected.
    fn plain(&self) -> Values {
        let numbers = self.observed.catalogue.numbers.iter().enumerate();
        let value = |(i, number): (usize, &Number)| {
            if self.active.contains(&i) { self.about.values[i] } else { number.expected }
        };
        numbers.map(value).collect()
    }

    fn replica(&self, truth: &[f64], noise: &ReportNoise) -> Result<Replica, VehicleError> {
        Replica::new(self.observed.catalogue, truth, noise, self.onboard)
    }

    /// The flights as a replica flies them, number `twin` of a seed.
    fn flown(&self, replica: &Replica, seed: u64, twin: u32) -> Vec<PreparedFlight> {
        let first = seed.wrapping_add(u64::from(twin) << 20);
        let seeds = (0..).map(|flight| first.wrapping_add(flight));
        let flights = self.observed.flights.iter().zip(seeds);
        flights.map(|(flight, seed)| replica.fly(flight, seed)).collect()
    }

    /// `count` twins of the vehicle `truth` with sensors of `noise`. Where the analysis fails, a
    /// twin is left out.
    fn twins(
        &self,
        truth: &[f64],
        noise: &ReportNoise,
        (count, seed): (u32, u64),
    ) -> Result<Vec<Twin>, VehicleError> {
        let replica = self.replica(truth, noise)?;
        let twins = (0..count).into_par_iter().filter(|_| !self.observed.is_stopped());
        Ok(twins.filter_map(|twin| self.twin(&self.flown(&replica, seed, twin))).collect())
    }

    fn twin(&self, flights: &[PreparedFlight]) -> Option<Twin> {
        let Self { observed, about, .. } = self;
        let flown = observed.like(flights);
        let residuals = flown.residuals(&about.values)?;
        let own = about.columns_of(&flown, &residuals, &self.noisy);
        let about = about.about_with(observed, &residuals, &own);
        let fit = about.solve(observed.catalogue, observed.counts(), self.active)?;
        let noise = report_noise(flights, &fit.power, observed.counts());
        let screened = Screened { residuals, own };
        Some(Twin { screened, values: fit.values, power: fit.power, noise })
    }

    /// Twins as the flights are, with sensors of `noise`: what `pilots` with these sensors are off
    /// by is taken off the flights' fit.
    fn draw(
        &self,
        pilots: Vec<Twin>,
        noise: &ReportNoise,
        draws: (u32, u64),
    ) -> Result<TwinFits, VehicleError> {
        let Self { observed, about, active, .. } = self;
        let bias = off_by(&pilots, &self.plain());
        let pilots = pilots.len() as u32;
        let truth: Values = observed
            .catalogue
            .numbers
            .iter()
            .enumerate()
            .map(|(i, number)| {
                let [low, high] = number.bounds;
                let value = (about.values[i] - bias[i]).clamp(low, high);
                if active.contains(&i) {
                    return value;
                }
                // What the null pushes to its limit is an effect, which twins must not have.
                let width = TRUTH_WITHIN * number.tolerance;
                value.clamp(number.expected - width, number.expected + width)
            })
            .collect();
        let drawn = self.twins(&truth, noise, draws)?;
        let mut twins = TwinFits {
            truth,
            sensors: *noise,
            bias,
            pilots,
            noisy: self.noisy.clone(),
            values: Vec::new(),
            power: Vec::new(),
            screened: Vec::new(),
        };
        for Twin { screened, values, power, .. } in drawn {
            twins.values.push(values);
            twins.power.push(power);
            // Own derivatives are for the screening, which twins of effects do not go through: what
            // else is tried on these leaves noisy numbers out.
            let own = if active.is_empty() { screened.own } else { Vec::new() };
            twins.screened.push(Screened { own, ..screened });
        }
        Ok(twins)
    }
}

/// By how much fits are off the truth on average, of each number.
fn off_by(twins: &[Twin], truth: &[f64]) -> Values {
    let off = |i: usize| twins.iter().map(move |twin| twin.values[i] - truth[i]);
    (0..truth.len()).map(|i| moments(off(i))[0]).collect()
}

impl TwinFits {
    /// Flies twins of the vehicle without an effect that `about` was linearised about, and fits its
    /// nuisances to each. `onboard`: the law that flies them. `noise`: what is found in the
    /// flights' reports. `draws`: how many twins, and a seed.
    ///
    /// A fit is off by itself: outputs that are logged less often than the loop ticks are noisy
    /// inputs, which makes an inertia look larger and a lag longer, for a lag with less of a delay
    /// smooths them; a latency between two reports does the same; and what is found as noise holds
    /// motion. Pilot twins tell by how much, each by derivatives with its own noise as the flights
    /// were, and the twins are of a vehicle and of sensors that are found as the flights' were
    /// (indirect inference; Gourieroux, Monfort and Renault 1993).
    ///
    /// # Errors
    /// A vehicle that the physics refuses.
    pub fn of_null(
        observed: &Observed<'_>,
        about: &Linearised,
        onboard: &OnboardLaw,
        noise: &ReportNoise,
        (count, seed): (u32, u64),
    ) -> Result<Self, VehicleError> {
        let [of_noise, of_bias] = PILOTS.map(|pilots| pilots.min(count));
        let (analysis, pilots) =
            Analysis::with_pilots(observed, about, &[], onboard, noise, (of_noise, !seed))?;
        let found = ReportNoise::mean(pilots.iter().map(|twin| &twin.noise));
        let noise = noise.matched(&found);
        let pilots = analysis.twins(&analysis.plain(), &noise, (of_bias, seed ^ OF_BIAS))?;
        analysis.draw(pilots, &noise, (count, seed))
    }

    /// The same of the vehicle with the effects whose numbers are `active`, fitted with them.
    /// `sensors`: as twins without an effect have them.
    ///
    /// # Errors
    /// As [`of_null`](Self::of_null).
    pub fn of_effects(
        observed: &Observed<'_>,
        about: &Linearised,
        active: &[usize],
        onboard: &OnboardLaw,
        sensors: &ReportNoise,
        (count, seed): (u32, u64),
    ) -> Result<Self, VehicleError> {
        let pilots = (PILOTS[1].min(count), seed ^ OF_BIAS);
        let (analysis, pilots) =
            Analysis::with_pilots(observed, about, active, onboard, sensors, pilots)?;
        analysis.draw(pilots, sensors, (count, seed))
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
        let truth = observed.catalogue.expected();
        let plain = |residuals| Screened { residuals, own: Vec::new() };
        Self {
            bias: vec![0.0; truth.len()],
            pilots: 0,
            noisy: Vec::new(),
            truth,
            sensors: ReportNoise::default(),
            values: Vec::new(),
            power,
            screened: residuals.into_iter().map(plain).collect(),
        }
    }

    /// Standard error of a number that was fitted and freed of [`bias`](Self::bias): the fits'
    /// scatter, the mean's over the pilots, and that a few twins tell the scatter itself to within a
    /// tenth or so (the first term of Student's quantile at 95 % over the normal one, Cornish and
    /// Fisher 1938); and what sets twins off from flights.
    pub fn error(&self, number: usize) -> f64 {
        let freedom = (self.values.len() as f64 - 1.0).max(1.0);
        let student = 1.0 + (Z90 * Z90 + 1.0) / (4.0 * freedom);
        let mean = 1.0 + 1.0 / f64::from(self.pilots.max(1));
        self.deviation(number) * student * mean.sqrt() * BEYOND_TWINS
    }

    /// Standard deviation of the fits of one number.
    pub fn deviation(&self, number: usize) -> f64 {
        let [_, deviation] = moments(self.values.iter().map(|values| values[number]));
        deviation
    }

    /// What each leaves at the values of the flights' fit.
    pub fn residuals(&self) -> impl Iterator<Item = &Residuals> {
        self.screened.iter().map(|screened| &screened.residuals)
    }

    /// Mean and standard deviation over the twins of what `of` makes of the sums of squares that
    /// each fit leaves.
    pub fn moments_of(&self, of: impl Fn(&[f64]) -> f64) -> [f64; 2] {
        moments(self.power.iter().map(|power| of(power)))
    }

    /// Mean and standard deviation of the sum of squares at each place.
    pub fn moments(&self) -> Vec<[f64; 2]> {
        (0..Place::COUNT).map(|place| self.moments_of(|power| power[place])).collect()
    }
}

/// Mean and standard deviation of draws; 0 of none, and the deviation of one.
fn moments(draws: impl Iterator<Item = f64> + Clone) -> [f64; 2] {
    let n = draws.clone().count().max(1) as f64;
    let mean = draws.clone().sum::<f64>() / n;
    let squares: f64 = draws.map(|draw| (draw - mean).powi(2)).sum();
    [mean, (squares / (n - 1.0).max(1.0)).sqrt()]
}

/// Screens twins of the flights that are fitted; `null` is the fit of the nuisances alone.
pub fn screened(
    search: &Search<'_>,
    null: &Explanation,
    about: &Linearised,
    twins: &TwinFits,
    seed: u64,
) -> Twins {
    let observed = search.fitted;
    // Beyond the sensors' noise: turbulence, vibration, what the model lacks. What the best of the
    // hypotheses explains is not noise: what lasts, like a moment, would pass for itself by chance.
    let least = search.least_power(about).unwrap_or_else(|| null.fit.power.clone());
    let more: Vec<f64> = twins
        .moments()
        .iter()
        .zip(null.fit.power.iter().zip(&least))
        .zip(observed.counts())
        .map(|(([mean, _], (null, best)), n)| (null.min(*best) - mean) / n.max(1.0))
        .map(|variance| variance.max(0.0).sqrt())
        .collect();
    let count = twins.screened.len() as u32;
    let gains: Vec<Vec<f64>> = twins
        .screened
        .par_iter()
        .enumerate()
        .map(|(twin, Screened { residuals, own })| {
            let mut residuals = residuals.clone();
            add_noise(observed, &more, !seed.wrapping_add(twin as u64), &mut residuals);
            let about = about.about_with(observed, &residuals, own);
            let mut gains = vec![0.0; search.catalogue.hypotheses.len()];
            for (hypothesis, gain) in search.screen(&about, &[]) {
                gains[hypothesis] = gain;
            }
            gains
        })
        .collect();
    let hypotheses = search.catalogue.hypotheses.len();
    let (chance, asked): (Vec<f64>, Vec<f64>) = (0..hypotheses)
        .map(|h| chance_and_asked(gains.iter().map(|gains| gains[h]).collect(), hypotheses))
        .unzip();
    let share = |gains: &Vec<f64>| {
        let beyond = gains.iter().zip(chance.iter().zip(&asked));
        beyond.map(|(gain, (chance, asked))| (gain - chance) / asked).fold(0.0, f64::max)
    };
    let mut largest: Vec<f64> = gains.iter().map(share).collect();
    largest.sort_by(f64::total_cmp);
    Twins { count, largest, chance, asked }
}

/// What chance gives of evidence, by the `gains` of twins, and what is asked beyond it of each of
/// so many that are `tried`, nats.
pub(in crate::diagnose) fn chance_and_asked(mut gains: Vec<f64>, tried: usize) -> (f64, f64) {
    gains.sort_by(f64::total_cmp);
    let chance = gains.get(gains.len() / 2).map_or(0.0, |gain| gain.max(0.0));
    let reached = exceeded_by(&gains, EXCEEDED / tried.max(1) as f64);
    (chance, (reached - chance).max(CHANCE_MIN))
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

/// The point that a share of what `ascending` is drawn from exceeds. Its upper half falls off
/// exponentially, and carries on so beyond the largest that was drawn.
fn exceeded_by(ascending: &[f64], share: f64) -> f64 {
    let n = ascending.len();
    if n < 2 {
        return 0.0;
    }
    let median = ascending[n / 2];
    let upper = &ascending[n / 2..];
    let slope = upper.iter().map(|gain| gain - median).sum::<f64>() / upper.len() as f64;
    median + slope * (0.5 / share).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_hundredth_of_an_exponential_distribution_exceeds_is_found() {
        let n = 2000;
        // Quantiles of an exponential distribution with mean 3.
        let drawn: Vec<f64> =
            (0..n).map(|i| -3.0 * (1.0 - (f64::from(i) + 0.5) / f64::from(n)).ln()).collect();
        let expected = 3.0 * 100.0_f64.ln();
        let found = exceeded_by(&drawn, 0.01);
        assert!((found / expected - 1.0).abs() < 0.02, "{found}");
    }
}
