//! Writes out a law: its terms with their intervals, and the range of each quantity in the flights.

use std::collections::BTreeMap;

use vehicle::effects::EffectSet;
use vehicle::frame::Ned;
use vehicle::law::{Law, LawText, Needed, Quantity};
use vehicle::physics::{Environment, Physics};
use vehicle::rigid_body::State;

use super::Draft;
use crate::diagnose::catalogue::term::law_of;
use crate::diagnose::context::DiagnosisContext;
use crate::diagnose::discovery::law::{Shape, TermAnswer};
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::flights::series::attitude;
use crate::diagnose::likelihood::fit::interval;
use crate::diagnose::verdict::calibration::Calibration;

/// Sampling period of [`observed_ranges`](DiagnosisContext::observed_ranges), s.
const SAMPLING_S: f64 = 0.1;

impl DiagnosisContext<'_> {
    /// The terms for the answer, with their names in the law's file.
    pub(super) fn terms_of(&self, draft: &Draft) -> Vec<TermAnswer> {
        let first = self.catalogue.numbers.len();
        let mut terms: Vec<TermAnswer> = draft
            .terms
            .iter()
            .enumerate()
            .map(|(index, (term, _))| {
                let value = draft.fit.values[first + index];
                let deviation =
                    Calibration::shipped().deviation(draft.fit.deviation[first + index], value);
                let shape = term.factor.shape().map(|(value, _)| Shape {
                    value,
                    interval: interval(value, draft.deviations[index]),
                });
                TermAnswer {
                    term: term.text(),
                    name: format!("c{}", index + 1),
                    value,
                    interval: interval(value, deviation),
                    unit: term.unit().to_string(),
                    shape,
                    evidence: draft.gains[index],
                }
            })
            .collect();
        terms.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        terms
    }

    /// The law with its range of validity, and the effects beside it.
    pub(super) fn law_with_effects(
        &self,
        draft: &Draft,
        name: &str,
    ) -> Result<(Law, EffectSet), DiagnoseError> {
        let first = self.catalogue.numbers.len();
        let coefficients = draft.terms.iter().zip(&draft.fit.values[first..]);
        let text = law_of(coefficients.map(|((term, _), value)| (term, *value)));
        let mut text: LawText = text.unwrap_or_default();
        text.about = Some("written by downwash diagnose --discover".to_owned());
        text.intervals_90 =
            self.terms_of(draft).into_iter().map(|term| (term.name, term.interval)).collect();
        text.range = self.observed_ranges(draft)?;
        let law = Law::new(name, text)?;
        let which: Vec<_> =
            draft.beside.iter().map(|h| self.catalogue.hypotheses[*h].effect).collect();
        let mut effects = self.catalogue.effects(&draft.fit.values, Some(&which));
        // The name is free, since the set has no other law.
        let _ = effects.insert_law(law.clone());
        Ok((law, effects))
    }

    /// The range in the fitted flights of each quantity that a law reads.
    fn observed_ranges(&self, draft: &Draft) -> Result<BTreeMap<String, [f64; 2]>, DiagnoseError> {
        let all = draft.terms.iter().flat_map(|(term, _)| term.quantities());
        let needed = all.fold(Needed::default(), Needed::with);
        let physics = Physics::new(self.input.vehicle, &EffectSet::new())?;
        let mut range: BTreeMap<String, [f64; 2]> = BTreeMap::new();
        for flight in self.input.fitted {
            for span in &flight.spans {
                let count = ((span.end - span.start) / SAMPLING_S) as usize;
                for sample in 0..count {
                    let time = span.start + sample as f64 * SAMPLING_S;
                    let values = quantities(flight, &physics, needed, time);
                    // A heading wraps around.
                    for quantity in needed.iter().filter(|q| *q != Quantity::Heading) {
                        let value = values[quantity as usize];
                        let [low, high] =
                            range.entry(quantity.name().to_owned()).or_insert([value; 2]);
                        (*low, *high) = (low.min(value), high.max(value));
                    }
                }
            }
        }
        range.values_mut().flatten().for_each(|end| *end = rounded(*end));
        Ok(range)
    }
}

/// Quantities of a flight from its reports at `time`.
fn quantities(
    flight: &PreparedFlight,
    physics: &Physics,
    needed: Needed,
    time: f64,
) -> [f64; vehicle::law::QUANTITIES] {
    let state = State {
        position: flight.position.at(time).into(),
        velocity: flight.velocity.at(time).into(),
        attitude: attitude(flight.attitude.at(time)),
        body_rate: flight.body_rate.at(time).into(),
    };
    let [volts] = if flight.channels.voltage { flight.voltage.at(time) } else { [f64::NAN] };
    let calm = physics.calm();
    let voltage = if volts.is_finite() { volts } else { calm.voltage };
    let env = Environment { time, ..physics.environment(voltage, Ned::zero()) };
    let loads = physics.loads(&flight.outputs.at(time), &env);
    physics.quantities(needed, &state, &loads, &env)
}

/// A number to four significant digits.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return 0.0;
    }
    let scale = 10_f64.powf(3.0 - value.abs().log10().floor());
    (value * scale).round() / scale
}
