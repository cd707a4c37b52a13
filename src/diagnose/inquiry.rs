//! The context of a diagnosis: flights, catalogue and on-board law, and simulators of explanations.

use vehicle::VehicleError;
use vehicle::effects::{EffectId, EffectSet};

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::flights::arrival::Delay;
use crate::diagnose::flights::case::{Case, Settings};
use crate::diagnose::flights::onboard::OnboardLaw;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::likelihood::residuals::Evaluator;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::simulate::metric::Metric;
use crate::diagnose::simulate::open_loop::Simulator;

/// Everything that follows from a case's flights and vehicle file before any fit.
pub(super) struct Premises {
    pub evaluator: Evaluator,
    /// Whether the leg from setpoints to outputs is compared.
    pub leg: bool,
    /// The setpoints' delay, measured from the outputs.
    pub arrival: Option<Delay>,
    /// Half a period of the outputs' reports, s.
    held: f64,
}

impl Premises {
    /// The premises of a case.
    pub fn of(case: &Case<'_>) -> Self {
        let evaluator = Evaluator::new(case.vehicle).observing(case.fitted).until(case.stop);
        let is_led = |flight: &PreparedFlight| flight.channels.setpoint;
        let leg = case.fitted.iter().chain(case.held_out).all(is_led);
        let onboard = evaluator.onboard().filter(|_| leg);
        let arrival = onboard.and_then(|law| Delay::of(case.fitted, law));
        // The stamp of an output is accurate to half a period of the reports.
        let rates = case.fitted.iter().map(|flight| flight.outputs.rate());
        let held = 0.5 / rates.fold(f64::INFINITY, f64::min);
        Self { evaluator, leg, arrival, held }
    }

    /// The law from setpoints to outputs, where all logs hold both.
    pub fn onboard(&self) -> Option<&OnboardLaw> {
        self.evaluator.onboard().filter(|_| self.leg)
    }

    /// The catalogue, with the tolerances that the vehicle file does not state multiplied by
    /// `scale`.
    pub fn catalogue(&self, case: &Case<'_>, scale: f64) -> Catalogue {
        let catalogue = Catalogue::at_scale(case.vehicle, self.leg, scale)
            .without(case.without)
            .with_outputs_held(self.held);
        match &self.arrival {
            Some(delay) => catalogue.with_delay(delay),
            None => catalogue,
        }
    }
}

/// The context of a diagnosis.
pub(super) struct Inquiry<'a> {
    pub case: &'a Case<'a>,
    pub settings: &'a Settings,
    pub evaluator: &'a Evaluator,
    pub catalogue: &'a Catalogue,
    /// The law from setpoints to outputs, where all logs hold both.
    pub onboard: Option<&'a OnboardLaw>,
    /// The setpoints' delay, measured from the outputs.
    pub arrival: Option<Delay>,
    /// Flights for fitting, for choosing, both together, and held out.
    pub fitted: Observed<'a>,
    pub choosing: Observed<'a>,
    pub all: Observed<'a>,
    pub reported: Observed<'a>,
    /// The metric of the predictions.
    pub metric: Metric,
    /// The axes about which the body's turning is compared: front, right, down.
    pub axes: [bool; 3],
}

impl Inquiry<'_> {
    /// Whether the leg from setpoints to outputs is compared.
    pub fn leg(&self) -> bool {
        self.onboard.is_some()
    }

    /// A simulator of the vehicle file with `effects` over it.
    pub fn simulator(&self, effects: &EffectSet) -> Result<Simulator, VehicleError> {
        let simulator = Simulator::new(self.case.vehicle, effects, self.leg())?;
        Ok(simulator.compared_by(self.metric, self.axes))
    }

    /// A simulator with some of an explanation's numbers: those of the effects `which`, and with
    /// `file` those of the vehicle file.
    pub fn simulator_of(
        &self,
        explanation: &Explanation,
        which: &[EffectId],
        file: bool,
    ) -> Result<Simulator, VehicleError> {
        let values = &explanation.fit.values;
        let own = self.effects_of(explanation);
        let (vehicle, all) = self.catalogue.vehicle_of(values);
        let mut effects = EffectSet::new();
        for (id, slots) in all.iter() {
            let is_in = if own.contains(&id) { which.contains(&id) } else { file };
            if is_in {
                // This insertion has succeeded before.
                let _ = effects.insert(id, *slots);
            }
        }
        let simulator = self.simulator(&effects)?;
        if file { simulator.flying(&vehicle, &effects) } else { Ok(simulator) }
    }

    /// The effects of an explanation, one for each of its hypotheses.
    pub fn effects_of(&self, explanation: &Explanation) -> Vec<EffectId> {
        let hypotheses = explanation.fit.hypotheses.iter();
        hypotheses.map(|h| self.catalogue.hypotheses[*h].effect).collect()
    }
}
