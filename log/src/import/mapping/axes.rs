//! Axes of tables, and their conversion to NED and FRD.

use serde::Deserialize;
use vehicle::frame::{Attitude, Frd, Ned};

/// Names of world axes, with the axis of NED and the sign.
const WORLD: [(&str, (usize, f64)); 6] = [
    ("north", (0, 1.0)),
    ("south", (0, -1.0)),
    ("east", (1, 1.0)),
    ("west", (1, -1.0)),
    ("down", (2, 1.0)),
    ("up", (2, -1.0)),
];
/// Names of body axes, with the axis of FRD and the sign.
const BODY: [(&str, (usize, f64)); 6] = [
    ("front", (0, 1.0)),
    ("back", (0, -1.0)),
    ("right", (1, 1.0)),
    ("left", (1, -1.0)),
    ("down", (2, 1.0)),
    ("up", (2, -1.0)),
];

/// Directions of a table's first, second and third axis: an axis of NED or FRD, and its sign.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Axes([(usize, f64); 3]);

impl Axes {
    fn vector(self, components: [f64; 3]) -> [f64; 3] {
        let mut out = [0.0; 3];
        for ((axis, sign), component) in self.0.into_iter().zip(components) {
            out[axis] = sign * component;
        }
        out
    }

    /// +1 if the axes are right-handed, else -1.
    fn hand(self) -> f64 {
        let [(a, x), (b, y), (c, z)] = self.0;
        let is_even = (b + 3 - a) % 3 == 1 && (c + 3 - b) % 3 == 1;
        x * y * z * if is_even { 1.0 } else { -1.0 }
    }

    /// The rotation from these axes to NED or FRD; for left-handed axes, from their opposites.
    fn turn(self) -> Attitude {
        let hand = self.hand();
        let mut matrix = [0.0; 9];
        for (column, (row, sign)) in self.0.into_iter().enumerate() {
            matrix[3 * row + column] = hand * sign;
        }
        // A signed permutation without reflection is a rotation.
        from_matrix(matrix).unwrap_or_default()
    }

    fn parse(
        text: &AxesText,
        named: &[(&str, Self)],
        words: &[(&str, (usize, f64)); 6],
    ) -> Result<Self, String> {
        let list = || words.map(|(word, _)| word).join(", ");
        let names =
            || named.iter().map(|(name, _)| format!("{name:?}")).collect::<Vec<_>>().join(", ");
        let unknown = |found: &str| {
            format!(
                "expected {}, or a list of where the three axes point, each one of {}; found {found}",
                names(),
                list()
            )
        };
        match text {
            AxesText::Name(name) => {
                let known = named.iter().find(|(known, _)| known == name);
                known.map(|(_, axes)| *axes).ok_or_else(|| unknown(&format!("{name:?}")))
            }
            AxesText::List(list) => {
                let mut axes = [(0, 0.0); 3];
                for (axis, word) in axes.iter_mut().zip(list) {
                    let known = words.iter().find(|(known, _)| known == word);
                    *axis = known.ok_or_else(|| unknown(&format!("{word:?}")))?.1;
                }
                let mut used = axes.map(|(axis, _)| axis);
                used.sort_unstable();
                match used {
                    [0, 1, 2] => Ok(Self(axes)),
                    _ => Err(unknown("two that point along one line")),
                }
            }
        }
    }
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "expected a name of axes, or a list of where the three axes point")]
enum AxesText {
    Name(String),
    List([String; 3]),
}

/// Axes of the world: a name, or the directions of the three axes, such as `["north", "up",
/// "east"]`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "AxesText")]
pub struct WorldFrame(Axes);

impl TryFrom<AxesText> for WorldFrame {
    type Error = String;

    fn try_from(text: AxesText) -> Result<Self, String> {
        let named = [("ned", Self::NED.0), ("enu", Self::ENU.0), ("nwu", Self::NWU.0)];
        Axes::parse(&text, &named, &WORLD).map(Self)
    }
}

impl WorldFrame {
    /// North, east, down.
    pub const NED: Self = Self(Axes([(0, 1.0), (1, 1.0), (2, 1.0)]));
    /// East, north, up.
    pub const ENU: Self = Self(Axes([(1, 1.0), (0, 1.0), (2, -1.0)]));
    /// North (or any horizontal x), west (left of x), up: the usual axes of motion capture.
    pub const NWU: Self = Self(Axes([(0, 1.0), (1, -1.0), (2, -1.0)]));

    /// Converts a vector from these axes.
    pub fn to_ned(self, vector: [f64; 3]) -> Ned {
        self.0.vector(vector).into()
    }

    /// Converts an angular velocity from these axes; in left-handed axes, rotations are left-handed
    /// too.
    pub fn turning_to_ned(self, vector: [f64; 3]) -> Ned {
        self.to_ned(vector.map(|c| c * self.0.hand()))
    }
}

/// Axes of the body: a name, or the directions of the three axes, such as `["front", "up",
/// "right"]`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "AxesText")]
pub struct BodyFrame(Axes);

impl TryFrom<AxesText> for BodyFrame {
    type Error = String;

    fn try_from(text: AxesText) -> Result<Self, String> {
        let named = [("frd", Self::FRD.0), ("flu", Self::FLU.0)];
        Axes::parse(&text, &named, &BODY).map(Self)
    }
}

impl BodyFrame {
    /// Front, right, down.
    pub const FRD: Self = Self(Axes([(0, 1.0), (1, 1.0), (2, 1.0)]));
    /// Front, left, up.
    pub const FLU: Self = Self(Axes([(0, 1.0), (1, -1.0), (2, -1.0)]));

    /// Converts a vector from these axes.
    pub fn to_frd(self, vector: [f64; 3]) -> Frd {
        self.0.vector(vector).into()
    }

    /// Converts an angular velocity from these axes; in left-handed axes, rotations are left-handed
    /// too.
    pub fn turning_to_frd(self, vector: [f64; 3]) -> Frd {
        self.to_frd(vector.map(|c| c * self.0.hand()))
    }
}

/// Converts rotations from body to world in a table's axes to rotations from FRD to NED.
#[derive(Clone, Copy, Debug)]
pub struct AttitudeTurn {
    world: Attitude,
    /// From FRD to the table's body axes.
    body: Attitude,
}

impl AttitudeTurn {
    /// Creates the conversion for these axes. Returns `None` if one frame is left-handed and the
    /// other is not: no rotation relates them.
    pub fn new(world: WorldFrame, body: BodyFrame) -> Option<Self> {
        let is_one_hand = world.0.hand() == body.0.hand();
        is_one_hand.then(|| Self { world: world.0.turn(), body: body.0.turn().inverse() })
    }

    /// Converts a rotation from body to world to one from FRD to NED.
    pub fn apply(self, rotation: Attitude) -> Attitude {
        self.world.compose(rotation).compose(self.body).normalized()
    }
}

/// Normalises a quaternion whose norm is within 1 % of 1; else `None`.
pub(super) fn unit(q: Attitude) -> Option<Attitude> {
    let norm = q.w.hypot(q.x).hypot(q.y).hypot(q.z);
    ((norm - 1.0).abs() < 0.01).then(|| q.normalized())
}

/// The rotation of a matrix in row-major order (Shepperd's method: the largest component first).
pub(super) fn from_matrix(m: [f64; 9]) -> Option<Attitude> {
    let [xx, xy, xz, yx, yy, yz, zx, zy, zz] = m;
    let squares = [1.0 + xx + yy + zz, 1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz];
    let largest = (0..4).max_by(|a, b| squares[*a].total_cmp(&squares[*b]))?;
    let q = match largest {
        0 => [squares[0], zy - yz, xz - zx, yx - xy],
        1 => [zy - yz, squares[1], xy + yx, xz + zx],
        2 => [xz - zx, xy + yx, squares[2], yz + zy],
        _ => [yx - xy, xz + zx, yz + zy, squares[3]],
    };
    let [w, x, y, z] = q.map(|c| c / (2.0 * squares[largest].max(0.0).sqrt()));
    let rotation = unit(Attitude { w, x, y, z })?;
    // A mirrored or skewed matrix does not survive the round trip.
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        .map(|axis| rotation.to_world(Frd::from(axis)).to_array());
    let is_rotation = (0..3)
        .all(|row| (0..3).all(|column| (axes[column][row] - m[3 * row + column]).abs() < 0.02));
    is_rotation.then_some(rotation)
}
