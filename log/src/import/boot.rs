//! A boot of the vehicle among several in one log.

/// Largest number of boots listed; a damaged log may have any number.
const BOOTS_NAMED: usize = 20;

/// When a boot was logged, and how much of it flew.
#[derive(Clone, Copy, Debug)]
pub(super) struct Boot {
    /// First and last time of the vehicle's clock, s.
    pub span: [f64; 2],
    /// Time in the air, s.
    pub flown: f64,
}

impl Boot {
    /// Notes on several boots, for people; none on a single one.
    pub fn notes(boots: &[Self], chosen: usize) -> Vec<String> {
        let count = boots.len();
        let note = |(at, boot): (usize, &Self)| {
            let (number, Self { span: [from, to], flown }) = (at + 1, boot);
            let used = if at == chosen { ", used" } else { "" };
            format!(
                "boot {number} of {count} (--boot {number}): {from:.2} to {to:.2} s, {flown:.1} s \
                 of it flown{used}"
            )
        };
        let is_named = |(at, _): &(usize, &Self)| count > 1 && (*at < BOOTS_NAMED || *at == chosen);
        boots.iter().enumerate().filter(is_named).map(note).collect()
    }
}
