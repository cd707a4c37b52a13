//! Forms of feedback that meet the changes.

use downwash::control::{Law, Use};
use downwash::station::StationSettings;

/// One form of feedback.
#[derive(Clone, Copy, Debug)]
pub struct Feedback {
    pub name: &'static str,
    law: &'static str,
    observer: Use,
    adaptive: bool,
}

const fn plain(name: &'static str) -> Feedback {
    Feedback { name, law: name, observer: Use::Off, adaptive: false }
}

impl Feedback {
    pub const ORACLE: Self =
        Self { name: "lqr+adaptive", law: "lqr", observer: Use::Off, adaptive: true };

    /// The paper's comes first: it is the baseline.
    pub const ALL: [Self; 7] = [
        plain("lqr"),
        plain("geometric"),
        Self { name: "lqr+observer", law: "lqr", observer: Use::On, adaptive: false },
        plain("l1"),
        plain("geometric-adaptive"),
        Self::ORACLE,
        Self { name: "geometric+adaptive", law: "geometric", observer: Use::Off, adaptive: true },
    ];

    pub fn named_oracle() -> Self {
        Self { name: "(oracle)", ..Self::ORACLE }
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|feedback| feedback.name == name)
    }

    pub fn set(&self, settings: &mut StationSettings) {
        settings.control.law =
            Law::named(self.law).unwrap_or_else(|| panic!("no law {}", self.law));
        settings.control.adaptive = self.adaptive;
        settings.offboard.offset_free.observer = self.observer;
        settings.offboard.offset_free.feed_forward = Use::On;
    }
}
