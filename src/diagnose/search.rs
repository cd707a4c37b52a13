//! The search: which effects are chosen against what nuisances and chance explain, what their fit
//! is off by, and what it leaves.

use sitl::effects::{EffectId, EffectSet};

use super::constancy::Constancy;
use super::fit::Fit;
use super::hypothesis::Catalogue;
use super::inquiry::Inquiry;
use super::linearised::Linearised;
use super::misfit::{Misfit, misfit, share_left};
use super::naming::idle;
use super::noise::{ReportNoise, report_noise};
use super::procedure::DiagnoseError;
use super::scored::Scored;
use super::selection::{Selection, Selector, Thresholds};
use super::strain::{Strain, level_in_place_of, strains};
use super::twins::{TwinFits, Twins, screened};

/// Twins of the best explanation, against which what it leaves is compared.
const TWINS_OF_BEST: u32 = 16;

/// What was found.
pub(super) struct Search {
    /// The chosen effects, without what the fit is off by, and their rivals.
    pub selection: Selection,
    /// Noise of the reports.
    pub noise: ReportNoise,
    /// What twins without an effect have by chance.
    pub twins: Option<Twins>,
    /// What was asked of an effect.
    pub thresholds: Thresholds,
    /// What the chosen effects leave, or the nuisances alone where there are none; nothing where no
    /// twins can be flown.
    pub misfit: Vec<Misfit>,
    /// Numbers that are strained beside the chosen effects.
    pub strained: Vec<Strain>,
    /// The thrust's level, where it may be all that a chosen effect stands for.
    pub level: Option<Strain>,
    /// Whether the chosen effects are constant, as far as twins tell.
    pub constancy: Constancy,
    /// The hypothesis that was chosen alone and dropped, for its numbers may be the file's.
    pub dropped: Option<usize>,
    /// Twins without an effect, and of the chosen effects where there are any.
    pub of_null: Option<TwinFits>,
    pub of_best: Option<TwinFits>,
}

impl Search {
    /// The chosen effects.
    pub fn named(&self, catalogue: &Catalogue) -> Vec<EffectId> {
        let chosen = self.selection.best.fit.hypotheses.iter();
        chosen.map(|h| catalogue.hypotheses[*h].effect).collect()
    }
}

/// What a fit leaves beyond its twins, and numbers that are strained.
type Checked = (Vec<Misfit>, Vec<Strain>);

/// Twins of the vehicle of a fit, and the derivatives there.
pub(super) struct FlownFit {
    pub about: Linearised,
    pub twins: TwinFits,
}

impl Inquiry<'_> {
    /// Twins, and the search among the effects against what they say.
    pub fn search(&self, progress: &dyn Fn(&str)) -> Result<Search, DiagnoseError> {
        let Self { settings, fitted, catalogue, .. } = self;
        let mut selector = Selector {
            fitted,
            held_out: &self.held_out,
            catalogue,
            setpoint_leg: self.leg(),
            thresholds: Thresholds::default(),
            floor: None,
        };
        progress("what nuisances explain");
        let (null, about) = selector.null().ok_or(DiagnoseError::Nothing)?;
        let noise = report_noise(self.case.fitted, &null.fit.power, fitted.counts());
        let mut chance = None;
        if settings.twins > 0 {
            progress("twins without an effect");
            let found = self.chance(&selector, &null, &about, &noise)?;
            selector.thresholds.asked.clone_from(&found.0.asked);
            selector.thresholds.chance.clone_from(&found.0.chance);
            chance = Some(found);
        }
        let (twins, of_null) = chance.unzip();
        let sensors = self.sensors(of_null.as_ref(), &noise);
        let shipped = self.simulator(&EffectSet::new())?.guided();
        selector.floor =
            shipped.floor(self.case.fitted, &noise, settings.seed).map(|floor| floor.errors);
        progress("which effect");
        let mut selection = selector.select(null, &about).ok_or(DiagnoseError::Nothing)?;
        let mut dropped = None;
        let nearest = loop {
            let nearest = self.nearest_twins(&mut selection, &sensors);
            let Some((_, flown)) = &nearest else { break nearest };
            correct(&mut selection.best, catalogue, &flown.twins);
            self.take_up_delay(&mut selection.best);
            let Some(place) = idle(&selection, catalogue) else { break nearest };
            let Some(less) = selector.dropping(&about, &selection, place) else { break nearest };
            if let [alone] = selection.best.fit.hypotheses[..] {
                dropped = Some(alone);
            }
            selection = less;
        };
        let flown = nearest.as_ref().map(|(_, flown)| flown);
        let constancy = flown.map(|flown| self.constancy(&selection, flown)).unwrap_or_default();
        let level = level_in_place_of(&selection.best.fit, fitted, &about);
        let ((misfit, strained), of_best) = match nearest {
            Some((checked, flown)) => (checked, Some(flown.twins)),
            None => {
                let null = &selection.null.fit;
                let found = !selection.best.fit.hypotheses.is_empty();
                let alone = of_null.as_ref().filter(|_| !found && self.leg());
                (alone.map(|twins| self.checked(null, null, twins)).unwrap_or_default(), None)
            }
        };
        let thresholds = selector.thresholds;
        Ok(Search {
            selection,
            noise,
            twins,
            thresholds,
            misfit,
            strained,
            level,
            constancy,
            dropped,
            of_null,
            of_best,
        })
    }

    /// What chance gives the hypotheses, and the twins without an effect that tell it. `null`: the
    /// fit of the nuisances, with the derivatives there; `noise`: of the reports.
    fn chance(
        &self,
        selector: &Selector<'_>,
        null: &Scored,
        about: &Linearised,
        noise: &ReportNoise,
    ) -> Result<(Twins, TwinFits), DiagnoseError> {
        let Self { settings, fitted, catalogue, .. } = self;
        let draws = (settings.twins, settings.seed);
        let Some(law) = self.onboard else {
            let twins = TwinFits::of_noise(fitted, &null.fit.power, draws);
            let about = about.resting_at(catalogue.expected());
            return Ok((screened(selector, null, &about, &twins, settings.seed), twins));
        };
        let twins = TwinFits::of_null(fitted, about, law, noise, draws)?;
        Ok((screened(selector, null, about, &twins, settings.seed), twins))
    }

    /// The twins of what was chosen that come nearest to the flights, and what is left beyond them.
    ///
    /// Within a tick of the loop a fit finds any delay, and the outputs tell about as much: which
    /// of the two was flown, twins of both must say.
    fn nearest_twins(
        &self,
        selection: &mut Selection,
        sensors: &ReportNoise,
    ) -> Option<(Checked, FlownFit)> {
        let mut flown = vec![selection.best.clone()];
        if self.take_up_delay(&mut selection.best) {
            flown.push(selection.best.clone());
        }
        let of_flown = flown.iter().filter_map(|scored| {
            let flown = self.twins_of(scored, sensors)?;
            Some((self.checked(&selection.null.fit, &scored.fit, &flown.twins), flown))
        });
        of_flown.min_by(|((a, _), _), ((b, _), _)| share_left(a).total_cmp(&share_left(b)))
    }

    /// What a fit leaves beyond its twins, and the numbers that they show to be strained.
    fn checked(&self, null: &Fit, fit: &Fit, twins: &TwinFits) -> Checked {
        let misfit = misfit(null, fit, twins, self.fitted.counts());
        (misfit, strains(self.catalogue, fit, twins))
    }

    /// Noise of the sensors: as twins without an effect tell it, or that of the reports.
    fn sensors(&self, of_null: Option<&TwinFits>, reports: &ReportNoise) -> ReportNoise {
        of_null.filter(|_| self.leg()).map_or(*reports, |twins| twins.sensors)
    }

    /// `scored` without what its own twins are off by, with their error.
    pub(super) fn freed(&self, search: &Search, mut scored: Scored) -> Scored {
        let sensors = self.sensors(search.of_null.as_ref(), &search.noise);
        if let Some(flown) = self.twins_of(&scored, &sensors) {
            correct(&mut scored, self.catalogue, &flown.twins);
        }
        scored
    }

    /// Twins of the vehicle of a fit; `None` without an effect or a law to fly them by, or where
    /// none are asked for.
    fn twins_of(&self, scored: &Scored, sensors: &ReportNoise) -> Option<FlownFit> {
        let count = TWINS_OF_BEST.min(self.settings.twins);
        let law = self.onboard.filter(|_| count > 0 && !scored.fit.hypotheses.is_empty())?;
        let numbers: Vec<usize> = (0..self.catalogue.numbers.len()).collect();
        let about = Linearised::new(&self.fitted, &scored.fit.values, &numbers)?;
        let active = scored.fit.active(self.catalogue);
        let draws = (count, self.settings.seed);
        let twins =
            TwinFits::of_effects(&self.fitted, &about, &active, law, sensors, draws).ok()?;
        Some(FlownFit { about, twins })
    }

    /// A command_delay that was chosen is as the outputs say, where they do. Whether it was.
    fn take_up_delay(&self, best: &mut Scored) -> bool {
        let number = self.catalogue.number_of(EffectId::CommandDelay, 0);
        let chosen = number.filter(|n| best.fit.active(self.catalogue).contains(n));
        let Some((number, delay)) = chosen.zip(self.arrival) else { return false };
        best.fit.values[number] = delay.mean;
        best.fit.deviation[number] = delay.deviation;
        true
    }
}

/// Takes off a fit's effects what its twins are off by, and gives them the twins' error.
pub(super) fn correct(scored: &mut Scored, catalogue: &Catalogue, twins: &TwinFits) {
    for number in scored.fit.active(catalogue) {
        let [low, high] = catalogue.numbers[number].bounds;
        let value = &mut scored.fit.values[number];
        *value = (*value - twins.bias[number]).clamp(low, high);
        scored.fit.deviation[number] = twins.error(number);
    }
}
