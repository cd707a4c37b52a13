//! Twins: the flights as a vehicle with known numbers would fly them, with sensor noise (a
//! parametric bootstrap).
//!
//! A twin is a [`Replica`] of every fitted flight, and goes through the same analysis. Twins of the
//! vehicle with its nuisances alone set the threshold of each hypothesis: the gain of evidence that
//! it reaches in hardly any of them. This covers multiple testing, the noise that feedback puts
//! into the outputs, and the excitation of these very flights. Twins of the vehicle with the chosen
//! effects show the bias and the scatter of their fit. Without a known on-board law, twins are the
//! same motion with other noise, which has the spectrum of the flights' residuals.

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
use crate::diagnose::likelihood::column::{Column, Residuals};
use crate::diagnose::likelihood::fit::Z90;
use crate::diagnose::likelihood::layout::Bin;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::noise::{ReportNoise, report_noise};
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::search::Search;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::simulate::replica::Replica;

/// Least evidence beyond the median by chance that a threshold demands, nats.
const CHANCE_MIN: f64 = 3.0;
/// Share of twins in which any hypothesis may reach its threshold.
const FALSE_ALARM_SHARE: f64 = 0.01;

/// The thresholds from twins without an effect.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Twins {
    /// Number of twins.
    pub count: u32,
    /// Each twin's largest gain of evidence beyond chance, as a multiple of its hypothesis'
    /// threshold, ascending.
    pub largest: Vec<f64>,
    /// Gain of evidence that half of the twins exceed, for each hypothesis of the catalogue, nats:
    /// the gain from the bias of a fit.
    #[serde(skip)]
    pub chance: Vec<f64>,
    /// Threshold of the gain beyond that, for each hypothesis, nats. It is higher only for a
    /// hypothesis whose gain scatters from twin to twin.
    #[serde(skip)]
    pub thresholds: Vec<f64>,
}

/// Pilot twins, which measure the noise estimate and the bias of a fit.
const PILOT_TWINS: [u32; 2] = [6, 10];
/// Pilot twins that measure the noise of derivatives.
const DERIVATIVE_TWINS: u32 = 2;
/// Mixed into the seed of the second pilot twins, so that their noise differs from the twins'.
const BIAS_SEED: u64 = 0xb1a5;
/// Share of noise in a derivative's square above which each twin computes its own. Flights with
/// motion have 0.01 to 0.5 in derivatives by a lag, a delay of the outputs, a latency and an
/// inertia, and mostly below 0.008 in all others. A hover has 0.1 to 1 in those of the moments.
const NOISE_SHARE_MAX: f64 = 0.01;

/// Numbers scatter more than those of twins: without this factor, 87 % of 1260 numbers of two exams
/// and a round trip were within their 90 % intervals.
const ERROR_FACTOR: f64 = 1.08;

/// Most tolerances by which a nuisance of a vehicle without an effect may be off.
const TRUTH_TOLERANCES_MAX: f64 = 1.5;

/// How many twins to draw, and from which seed.
#[derive(Clone, Copy, Debug)]
pub struct Draws {
    /// Number of twins.
    pub count: u32,
    /// Seed of their noise.
    pub seed: u64,
}

/// Twins of flights, fitted like the flights.
#[derive(Clone, Debug)]
pub struct TwinFits {
    /// Numbers of their vehicle: the flights' fit, less its bias.
    pub truth: Values,
    /// Noise of their sensors, which the analysis estimates as it did the flights'.
    pub sensors: ReportNoise,
    /// Mean error of each number in the fits of pilot twins, whose nuisances are as expected. It
    /// excludes the pull of a prior towards the expected nuisances: where the flights' nuisances
    /// are elsewhere, only the flights' fit shows it.
    pub bias: Values,
    /// Number of those pilot twins.
    pilots: u32,
    /// Numbers whose derivatives are noisy: twins cannot use those of the flights.
    pub noisy: Vec<usize>,
    /// Fitted values of each twin.
    pub values: Vec<Values>,
    /// Sum of squares that each fit leaves in each bin.
    pub power: Vec<Vec<f64>>,
    /// Input of the screening that measures chance.
    screened: Vec<Screened>,
}

/// A twin evaluated at the values of the flights' fit.
#[derive(Clone, Debug)]
struct Screened {
    /// Its residuals there.
    residuals: Residuals,
    /// Its derivatives by the numbers whose derivatives are noisy.
    own: Vec<Column>,
}

/// A twin, analysed like the flights.
struct Twin {
    screened: Screened,
    values: Values,
    power: Vec<f64>,
    noise: ReportNoise,
}

/// How twins are flown and analysed.
struct Analysis<'a> {
    observed: &'a Observed<'a>,
    /// The linearisation of the flights.
    about: &'a Linearised,
    /// Numbers of the fitted effects.
    active: &'a [usize],
    onboard: &'a OnboardLaw,
    /// Numbers whose derivatives are noisy.
    noisy: Vec<usize>,
}

impl<'a> Analysis<'a> {
    /// The analysis and the first pilot twins, whose nuisances are as expected and whose sensors
    /// have `noise`.
    fn with_pilots(
        observed: &'a Observed<'a>,
        about: &'a Linearised,
        active: &'a [usize],
        onboard: &'a OnboardLaw,
        noise: &ReportNoise,
        draws: Draws,
    ) -> Result<(Self, Vec<Twin>), VehicleError> {
        let mut analysis = Self { observed, about, active, onboard, noisy: Vec::new() };
        let replica = analysis.replica(&analysis.expected_values(), noise)?;
        let probes: Vec<Vec<PreparedFlight>> = (0..DERIVATIVE_TWINS)
            .into_par_iter()
            .map(|pilot| analysis.flown(&replica, draws.seed, pilot))
            .collect();
        let [one, other] = &probes[..] else { return Ok((analysis, Vec::new())) };
        let shares =
            about.noise_shares([&observed.with_flights(one), &observed.with_flights(other)]);
        let noisy = shares.into_iter().filter(|(_, share)| *share > NOISE_SHARE_MAX);
        analysis.noisy = noisy.map(|(number, _)| number).collect();
        let probes = probes.par_iter().filter_map(|flights| analysis.twin(flights));
        let others =
            (DERIVATIVE_TWINS..draws.count).into_par_iter().filter(|_| !observed.is_stopped());
        let others = others.filter_map(|p| analysis.twin(&analysis.flown(&replica, draws.seed, p)));
        let pilots = probes.chain(others).collect();
        Ok((analysis, pilots))
    }

    /// The vehicle with the fitted effects and the expected nuisances.
    fn expected_values(&self) -> Values {
        let numbers = self.observed.catalogue.numbers.iter().enumerate();
        let value = |(i, number): (usize, &Number)| {
            if self.active.contains(&i) { self.about.values[i] } else { number.expected }
        };
        numbers.map(value).collect()
    }

    fn replica(&self, truth: &[f64], noise: &ReportNoise) -> Result<Replica, VehicleError> {
        Replica::new(self.observed.catalogue, truth, noise, self.onboard)
    }

    /// The flights as a replica flies them, for twin number `twin` of a seed.
    fn flown(&self, replica: &Replica, seed: u64, twin: u32) -> Vec<PreparedFlight> {
        let first = seed.wrapping_add(u64::from(twin) << 20);
        let seeds = (0..).map(|flight| first.wrapping_add(flight));
        let flights = self.observed.flights.iter().zip(seeds);
        flights.map(|(flight, seed)| replica.fly(flight, seed)).collect()
    }

    /// Flies and analyses twins of the vehicle `truth` with sensors of `noise`. A twin
    /// whose analysis fails is left out.
    fn twins(
        &self,
        truth: &[f64],
        noise: &ReportNoise,
        draws: Draws,
    ) -> Result<Vec<Twin>, VehicleError> {
        let replica = self.replica(truth, noise)?;
        let twins = (0..draws.count).into_par_iter().filter(|_| !self.observed.is_stopped());
        Ok(twins.filter_map(|twin| self.twin(&self.flown(&replica, draws.seed, twin))).collect())
    }

    fn twin(&self, flights: &[PreparedFlight]) -> Option<Twin> {
        let Self { observed, about, .. } = self;
        let flown = observed.with_flights(flights);
        let residuals = flown.residuals(&about.values)?;
        let own = flown.columns(&about.values, &residuals, &self.noisy);
        let about = about.with_residuals_and_columns(observed, &residuals, &own);
        let fit = about.solve(observed.catalogue, observed.counts(), self.active)?;
        let noise = report_noise(flights, &fit.power, observed.counts());
        let screened = Screened { residuals, own };
        Some(Twin { screened, values: fit.values, power: fit.power, noise })
    }

    /// Twins like the flights, with sensors of `noise`. Their vehicle is the flights' fit less the
    /// mean error of `pilots`, which have the same sensors.
    fn draw(
        &self,
        pilots: Vec<Twin>,
        noise: &ReportNoise,
        draws: Draws,
    ) -> Result<TwinFits, VehicleError> {
        let Self { observed, about, active, .. } = self;
        let bias = mean_errors(&pilots, &self.expected_values());
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
                // A nuisance that the fit pushes to its limit is an effect, which these twins must
                // not have.
                let width = TRUTH_TOLERANCES_MAX * number.tolerance;
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
            // Only the screening uses a twin's own derivatives, and twins of effects are not
            // screened. Other uses of these twins leave noisy numbers out.
            let own = if active.is_empty() { screened.own } else { Vec::new() };
            twins.screened.push(Screened { own, ..screened });
        }
        Ok(twins)
    }
}

/// Mean error of each number of the fits.
fn mean_errors(twins: &[Twin], truth: &[f64]) -> Values {
    let off = |i: usize| twins.iter().map(move |twin| twin.values[i] - truth[i]);
    (0..truth.len()).map(|i| moments(off(i))[0]).collect()
}

impl TwinFits {
    /// Flies twins of the vehicle without an effect at the linearisation `about`, and fits its
    /// nuisances to each. `onboard` is the law that flies them, `noise` the estimate from the
    /// flights' reports.
    ///
    /// A fit is biased. Outputs that are logged less often than the loop ticks are noisy inputs,
    /// which make an inertia look larger and a lag longer: a lag with less of a delay smooths them.
    /// A latency between two reports does the same, and the noise estimate contains motion. Pilot
    /// twins measure the bias, each with derivatives that have its own noise as the flights' have
    /// theirs. The twins are then of a vehicle and of sensors whose estimates match the flights'
    /// (indirect inference; Gourieroux, Monfort and Renault 1993).
    ///
    /// # Errors
    /// [`VehicleError`] for numbers that the physics rejects.
    pub fn of_null(
        observed: &Observed<'_>,
        about: &Linearised,
        onboard: &OnboardLaw,
        noise: &ReportNoise,
        draws: Draws,
    ) -> Result<Self, VehicleError> {
        let [for_noise, for_bias] = PILOT_TWINS.map(|pilots| pilots.min(draws.count));
        let of_noise = Draws { count: for_noise, seed: !draws.seed };
        let of_bias = Draws { count: for_bias, seed: draws.seed ^ BIAS_SEED };
        let (analysis, pilots) =
            Analysis::with_pilots(observed, about, &[], onboard, noise, of_noise)?;
        let found = ReportNoise::mean(pilots.iter().map(|twin| &twin.noise));
        let noise = noise.matched(&found);
        let pilots = analysis.twins(&analysis.expected_values(), &noise, of_bias)?;
        analysis.draw(pilots, &noise, draws)
    }

    /// As [`of_null`](Self::of_null) for the vehicle with the effects whose numbers are `active`,
    /// fitted with them. `sensors` is the noise of the twins without an effect.
    ///
    /// # Errors
    /// As [`of_null`](Self::of_null).
    pub fn of_effects(
        observed: &Observed<'_>,
        about: &Linearised,
        active: &[usize],
        onboard: &OnboardLaw,
        sensors: &ReportNoise,
        draws: Draws,
    ) -> Result<Self, VehicleError> {
        let pilots = Draws { count: PILOT_TWINS[1].min(draws.count), seed: draws.seed ^ BIAS_SEED };
        let (analysis, pilots) =
            Analysis::with_pilots(observed, about, active, onboard, sensors, pilots)?;
        analysis.draw(pilots, sensors, draws)
    }

    /// Twins without a known on-board law: the same motion with other noise, drawn from the
    /// spectrum of the residuals (`power`).
    pub fn of_noise(observed: &Observed<'_>, power: &[f64], draws: Draws) -> Self {
        let Draws { count, seed } = draws;
        let deviation: Vec<f64> =
            power.iter().zip(observed.counts()).map(|(q, n)| (q / n.max(1.0)).sqrt()).collect();
        let layouts = observed.layouts.iter();
        let still: Residuals = layouts.map(|layout| vec![0.0; layout.bins.len()]).collect();
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

    /// Standard error of a fitted number after removal of [`bias`](Self::bias). It combines the
    /// scatter of the fits, the error of the mean over the pilot twins, the uncertainty of the
    /// scatter itself (the first term of Student's quantile at 95 % over the normal one, Cornish
    /// and Fisher 1938: a tenth or so with a few twins), and the difference between twins and
    /// flights.
    pub fn error(&self, number: usize) -> f64 {
        let freedom = (self.values.len() as f64 - 1.0).max(1.0);
        let student = 1.0 + (Z90 * Z90 + 1.0) / (4.0 * freedom);
        let mean = 1.0 + 1.0 / f64::from(self.pilots.max(1));
        self.deviation(number) * student * mean.sqrt() * ERROR_FACTOR
    }

    /// Standard deviation of one number over the fits.
    pub fn deviation(&self, number: usize) -> f64 {
        let [_, deviation] = moments(self.values.iter().map(|values| values[number]));
        deviation
    }

    /// Residuals of each twin at the values of the flights' fit.
    pub fn residuals(&self) -> impl Iterator<Item = &Residuals> {
        self.screened.iter().map(|screened| &screened.residuals)
    }

    /// Mean and standard deviation over the twins of `of`, a function of the sums of squares that a
    /// fit leaves.
    pub fn moments_of(&self, of: impl Fn(&[f64]) -> f64) -> [f64; 2] {
        moments(self.power.iter().map(|power| of(power)))
    }

    /// Mean and standard deviation of the sum of squares in each bin.
    pub fn moments(&self) -> Vec<[f64; 2]> {
        (0..Bin::COUNT).map(|bin| self.moments_of(|power| power[bin])).collect()
    }
}

/// Mean and standard deviation of draws. Without a draw the mean is 0; with one the deviation is 0.
fn moments(draws: impl Iterator<Item = f64> + Clone) -> [f64; 2] {
    let n = draws.clone().count().max(1) as f64;
    let mean = draws.clone().sum::<f64>() / n;
    let squares: f64 = draws.map(|draw| (draw - mean).powi(2)).sum();
    [mean, (squares / (n - 1.0).max(1.0)).sqrt()]
}

/// Screens twins of the fitted flights. `null` is the fit of the nuisances alone.
pub fn screened(
    search: &Search<'_>,
    null: &Explanation,
    about: &Linearised,
    twins: &TwinFits,
    seed: u64,
) -> Twins {
    let observed = search.fitted;
    // Adds residuals beyond the sensors' noise: turbulence, vibration and gaps in the model. The
    // part that the best hypothesis explains is not noise: a lasting one, like a moment, would be
    // mistaken for itself.
    let least = search.powers(about).next().unwrap_or_else(|| null.fit.power.clone());
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
            let about = about.with_residuals_and_columns(observed, &residuals, own);
            let mut gains = vec![0.0; search.catalogue.hypotheses.len()];
            for (hypothesis, gain) in search.screen(&about, &[]) {
                gains[hypothesis] = gain;
            }
            gains
        })
        .collect();
    let hypotheses = search.catalogue.hypotheses.len();
    let (chance, thresholds): (Vec<f64>, Vec<f64>) = (0..hypotheses)
        .map(|h| chance_and_threshold(gains.iter().map(|gains| gains[h]).collect(), hypotheses))
        .unzip();
    let share = |gains: &Vec<f64>| {
        let beyond = gains.iter().zip(chance.iter().zip(&thresholds));
        beyond.map(|(gain, (chance, threshold))| (gain - chance) / threshold).fold(0.0, f64::max)
    };
    let mut largest: Vec<f64> = gains.iter().map(share).collect();
    largest.sort_by(f64::total_cmp);
    Twins { count, largest, chance, thresholds }
}

/// The evidence that chance gives, from the `gains` of twins, and the threshold beyond it for each
/// of `tried` hypotheses, nats.
pub(in crate::diagnose) fn chance_and_threshold(mut gains: Vec<f64>, tried: usize) -> (f64, f64) {
    gains.sort_by(f64::total_cmp);
    let chance = gains.get(gains.len() / 2).map_or(0.0, |gain| gain.max(0.0));
    let reached = exceeded_by(&gains, FALSE_ALARM_SHARE / tried.max(1) as f64);
    (chance, (reached - chance).max(CHANCE_MIN))
}

/// Adds white noise with a standard deviation for each bin.
fn add_noise(observed: &Observed<'_>, deviation: &[f64], seed: u64, residuals: &mut Residuals) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    for (residuals, layout) in residuals.iter_mut().zip(&observed.layouts) {
        for (residual, bin) in residuals.iter_mut().zip(&layout.bins) {
            let z: f64 = StandardNormal.sample(&mut rng);
            *residual += z * deviation[bin.index()];
        }
    }
}

/// The value that a share of the distribution of `ascending` exceeds. The upper half is taken as
/// exponential, also beyond the largest draw.
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
    fn one_percent_tail_of_an_exponential_is_found() {
        let n = 2000;
        // Quantiles of an exponential distribution with mean 3.
        let drawn: Vec<f64> =
            (0..n).map(|i| -3.0 * (1.0 - (f64::from(i) + 0.5) / f64::from(n)).ln()).collect();
        let expected = 3.0 * 100.0_f64.ln();
        let found = exceeded_by(&drawn, 0.01);
        assert!((found / expected - 1.0).abs() < 0.02, "{found}");
    }
}
