//! Additions to an answer after the diagnosis: a law, and the audit's findings.

use vehicle::effects::EffectId;

use crate::diagnose::answer::finding::listed;
use crate::diagnose::answer::text::law_sentence;
use crate::diagnose::answer::{Answer, FullVerdict, LogAnswer, NotTestable};
use crate::diagnose::discovery::law::LawAnswer;
use crate::diagnose::verdict::untestable::Untestable;

impl Answer {
    /// Adds a law, and a sentence about it to the finding.
    pub fn add_law(&mut self, law: LawAnswer) {
        self.finding.sentence += &format!(" {}", law_sentence(&law));
        self.law = Some(law);
    }

    /// Adds the audit's findings: the faults of logs, and the effects that no log's channels can
    /// show.
    pub fn add_logs(&mut self, logs: Vec<LogAnswer>) {
        let sound: Vec<&LogAnswer> = logs.iter().filter(|log| !log.is_faulty()).collect();
        let untestable =
            |log: &LogAnswer, id: EffectId| log.untestable.iter().any(|u| u.effect == id);
        if let Some(first) = sound.first() {
            for Untestable { effect, reason } in &first.untestable {
                let named = self.effects.iter().any(|e| e.id == *effect);
                let known = self.not_testable.iter().any(|e| e.id == *effect);
                if !named && !known && sound.iter().all(|log| untestable(log, *effect)) {
                    self.not_testable.push(NotTestable { id: *effect, reason: reason.clone() });
                }
            }
        }
        self.logs = logs;
        if self.finding.verdict == FullVerdict::None && !self.not_testable.is_empty() {
            self.finding.verdict = FullVerdict::NotTestable;
            let not_shown = listed(self.not_testable.iter().map(|effect| effect.id));
            self.finding.sentence +=
                &format!(" These flights and channels could not have shown {not_shown}.");
        }
    }
}
