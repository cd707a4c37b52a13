//! One log for each flight, for a daemon that outlives its flights.

use std::collections::{BTreeMap, VecDeque};
use std::time::Instant;

use message::clock::HostTime;

use super::record::Record;
use super::writer::{LogError, LogSummary, LogWriter};

/// Number of records kept from before a flight: about two seconds of a busy link.
const PRE_ROLL: usize = 2048;

/// Opens a log for the flight that starts at the given time.
pub type OpenLog = Box<dyn FnMut(HostTime) -> Result<LogWriter, LogError> + Send>;

/// Opens a log when a flight begins, adds the records from just before, and closes it when the
/// flight ends.
pub(super) struct FlightLogs {
    open: OpenLog,
    current: Option<LogWriter>,
    before: VecDeque<Record>,
    facts: BTreeMap<String, String>,
    last: Option<LogSummary>,
}

impl FlightLogs {
    pub fn new(open: OpenLog) -> Self {
        let before = VecDeque::with_capacity(PRE_ROLL);
        Self { open, current: None, before, facts: BTreeMap::new(), last: None }
    }

    pub fn write(&mut self, record: Record) -> Result<(), LogError> {
        match record {
            Record::FlightBegins(start) if self.current.is_none() => self.begin(start),
            Record::FlightBegins(_) => Ok(()),
            Record::FlightEnds => self.end(),
            record => {
                if let Record::Facts(facts) = &record {
                    self.facts.extend(facts.iter().map(|(k, v)| (k.clone(), v.clone())));
                }
                match &mut self.current {
                    Some(writer) => writer.write(&record),
                    None => {
                        if self.before.len() == PRE_ROLL {
                            self.before.pop_front();
                        }
                        self.before.push_back(record);
                        Ok(())
                    }
                }
            }
        }
    }

    pub fn sync_if_due(&mut self, wall: Instant) -> Result<(), LogError> {
        self.current.as_mut().map_or(Ok(()), |writer| writer.sync_if_due(wall))
    }

    /// Abandons the current log; the next flight gets a new one.
    pub fn abandon(&mut self) {
        self.current = None;
    }

    pub fn finish(mut self) -> Result<Option<LogSummary>, LogError> {
        self.end()?;
        Ok(self.last)
    }

    fn begin(&mut self, start: HostTime) -> Result<(), LogError> {
        let mut writer = (self.open)(start)?;
        if !self.facts.is_empty() {
            writer.write(&Record::Facts(Box::new(self.facts.clone())))?;
        }
        for record in self.before.drain(..).filter(|r| !matches!(r, Record::Facts(_))) {
            writer.write(&record)?;
        }
        self.current = Some(writer);
        Ok(())
    }

    fn end(&mut self) -> Result<(), LogError> {
        if let Some(writer) = self.current.take() {
            let summary = writer.finish()?;
            tracing::info!("log {}: {} messages", summary.path.display(), summary.messages);
            self.last = Some(summary);
        }
        Ok(())
    }
}
