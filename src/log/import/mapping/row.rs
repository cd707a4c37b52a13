//! Rows of a table into samples, once the mapping is bound to its columns.

use sitl::frame::{Attitude, Euler, Frd, Ned};

use super::axes::{BodyFrame, WorldFrame, attitude_to_ned};
use super::{Axes, ForceMeaning, QuaternionOrder};

const NO_NUMBER: &str = "row with a cell that is no finite number";
const NO_ROTATION: &str = "row whose attitude is no rotation";

/// A row of the table, in SI, NED and FRD. `None` is what the table does not have, or what a
/// row's empty cells leave out of voltage and setpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    pub time: f64,
    pub position: Option<Ned>,
    pub velocity: Option<Ned>,
    pub attitude: Option<Attitude>,
    pub body_rate: Option<Frd>,
    pub specific_force: Option<Frd>,
    pub outputs: Option<[f64; 4]>,
    pub rotor_speed: Option<[f64; 4]>,
    pub voltage: Option<f64>,
    pub setpoint_attitude: Option<Attitude>,
    pub setpoint_rate: Option<Frd>,
    pub setpoint_thrust: Option<f64>,
}

/// What the outputs of a mapped table are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outputs {
    /// Fractions of the full thrust.
    Fraction,
    /// N.
    Newton,
}

/// Columns of a vector and the factor to SI.
#[derive(Clone, Copy, Debug)]
pub(super) struct Columns<const N: usize> {
    pub(super) at: [usize; N],
    pub(super) factor: f64,
}

impl<const N: usize> Columns<N> {
    fn read(&self, cells: &[f64]) -> Option<[f64; N]> {
        let values = self.at.map(|at| cells.get(at).copied().unwrap_or(f64::NAN) * self.factor);
        values.iter().all(|value| value.is_finite()).then_some(values)
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Rotation {
    Quaternion(Columns<4>, QuaternionOrder),
    Euler(Columns<3>),
    Matrix(Columns<9>),
}

/// How an attitude is read.
#[derive(Clone, Copy, Debug)]
pub(super) struct AttitudeReader {
    pub(super) rotation: Rotation,
    pub(super) is_inverse: bool,
    pub(super) world: WorldFrame,
    pub(super) body: BodyFrame,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct VectorReader {
    pub(super) columns: Columns<3>,
    pub(super) axes: Axes,
}

#[derive(Clone, Debug)]
pub(super) struct MotorReader {
    pub(super) columns: Columns<4>,
    pub(super) range: [f64; 2],
    pub(super) polynomial: Option<Vec<f64>>,
}

/// A mapping bound to the columns of one table.
#[derive(Clone, Debug)]
pub struct RowReader {
    pub(super) world: WorldFrame,
    pub(super) body: BodyFrame,
    pub(super) time: TimeReader,
    pub(super) position: Option<Columns<3>>,
    pub(super) velocity: Option<VectorReader>,
    pub(super) attitude: Option<AttitudeReader>,
    pub(super) body_rate: Option<VectorReader>,
    pub(super) specific_force: Option<(VectorReader, ForceMeaning, f64)>,
    pub(super) motors: Option<MotorReader>,
    pub(super) rotor_speed: Option<Columns<4>>,
    pub(super) voltage: Option<Columns<1>>,
    pub(super) setpoint_attitude: Option<AttitudeReader>,
    pub(super) setpoint_rate: Option<VectorReader>,
    pub(super) setpoint_thrust: Option<Columns<1>>,
    pub(super) outputs: Outputs,
    pub(super) used: Vec<bool>,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum TimeReader {
    Column(Columns<1>),
    Rate(f64),
}

impl RowReader {
    /// What the outputs are.
    pub fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// Whether the mapping names a column.
    pub fn uses(&self, column: usize) -> bool {
        self.used.get(column).copied().unwrap_or(false)
    }

    /// The row with number `index` from the cells of its columns, NaN where there is no number.
    /// The error says why it is left out.
    pub fn read(&self, index: u64, cells: &[f64]) -> Result<Row, &'static str> {
        let time = match self.time {
            TimeReader::Column(column) => column.read(cells).ok_or(NO_NUMBER)?[0],
            TimeReader::Rate(rate) => index as f64 / rate,
        };
        let attitude = self.attitude.map(|reader| reader.read(cells)).transpose()?;
        let vector = |reader: VectorReader| reader.columns.read(cells).ok_or(NO_NUMBER);
        let position =
            self.position.map(|columns| columns.read(cells).ok_or(NO_NUMBER)).transpose()?;
        let turned = |reader: VectorReader| Ok::<_, &'static str>((vector(reader)?, reader.axes));
        let velocity = self.velocity.map(turned).transpose()?;
        let body_rate = self.body_rate.map(turned).transpose()?;
        let force = self
            .specific_force
            .map(|(reader, meaning, gravity)| {
                let (force, axes) = turned(reader)?;
                Ok::<_, &'static str>((force, axes, meaning, gravity))
            })
            .transpose()?;
        let outputs = self.motors.as_ref().map(|reader| reader.read(cells).ok_or(NO_NUMBER));
        let rotor_speed = self.rotor_speed.map(|columns| columns.read(cells).ok_or(NO_NUMBER));
        // Turned vectors have an attitude: it was asked for when the mapping was bound.
        let turn = attitude.unwrap_or_default();
        Ok(Row {
            time,
            position: position.map(|p| self.world.to_ned(p)),
            velocity: velocity.map(|(v, axes)| match axes {
                Axes::World => self.world.to_ned(v),
                Axes::Body => turn.to_world(self.body.to_frd(v)),
            }),
            attitude,
            body_rate: body_rate.map(|(rate, axes)| self.to_body(rate, axes, turn)),
            specific_force: force.map(|(force, axes, meaning, gravity)| {
                let force = self.to_body(force, axes, turn);
                match meaning {
                    ForceMeaning::SpecificForce => force,
                    ForceMeaning::Acceleration => force - turn.to_body(Ned::new(0.0, 0.0, gravity)),
                }
            }),
            outputs: outputs.transpose()?,
            rotor_speed: rotor_speed.transpose()?.map(|speeds| speeds.map(f64::abs)),
            voltage: self.voltage.and_then(|column| column.read(cells)).map(|[v]| v),
            setpoint_attitude: self.setpoint_attitude.and_then(|reader| reader.read(cells).ok()),
            setpoint_rate: self.setpoint_rate.and_then(|reader| {
                let rate = reader.columns.read(cells)?;
                (reader.axes == Axes::Body || attitude.is_some())
                    .then(|| self.to_body(rate, reader.axes, turn))
            }),
            setpoint_thrust: self.setpoint_thrust.and_then(|c| c.read(cells)).map(|[u]| u),
        })
    }

    fn to_body(&self, vector: [f64; 3], axes: Axes, turn: Attitude) -> Frd {
        match axes {
            Axes::Body => self.body.to_frd(vector),
            Axes::World => turn.to_body(self.world.to_ned(vector)),
        }
    }
}

impl AttitudeReader {
    fn read(&self, cells: &[f64]) -> Result<Attitude, &'static str> {
        let rotation = match self.rotation {
            Rotation::Euler(columns) => {
                let [roll, pitch, yaw] = columns.read(cells).ok_or(NO_NUMBER)?;
                Euler::new(roll, pitch, yaw).attitude()
            }
            Rotation::Quaternion(columns, order) => {
                let q = columns.read(cells).ok_or(NO_NUMBER)?;
                let [w, x, y, z] = match order {
                    QuaternionOrder::Wxyz => q,
                    QuaternionOrder::Xyzw => [q[3], q[0], q[1], q[2]],
                };
                unit(Attitude { w, x, y, z }).ok_or(NO_ROTATION)?
            }
            Rotation::Matrix(columns) => {
                from_matrix(columns.read(cells).ok_or(NO_NUMBER)?).ok_or(NO_ROTATION)?
            }
        };
        let rotation = if self.is_inverse { rotation.inverse() } else { rotation };
        Ok(attitude_to_ned(self.world, self.body, rotation))
    }
}

/// The quaternion scaled to unit length, if it is within 1 % of it.
fn unit(q: Attitude) -> Option<Attitude> {
    let norm = q.w.hypot(q.x).hypot(q.y).hypot(q.z);
    ((norm - 1.0).abs() < 0.01).then(|| q.normalized())
}

/// The rotation of a matrix, row by row (Shepperd's method: the largest component first).
fn from_matrix(m: [f64; 9]) -> Option<Attitude> {
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
    // A mirrored or skewed matrix comes back as another one.
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        .map(|axis| rotation.to_world(Frd::from(axis)).to_array());
    let is_rotation = (0..3)
        .all(|row| (0..3).all(|column| (axes[column][row] - m[3 * row + column]).abs() < 0.02));
    is_rotation.then_some(rotation)
}

impl MotorReader {
    fn read(&self, cells: &[f64]) -> Option<[f64; 4]> {
        let [zero, one] = self.range;
        let values = self.columns.read(cells)?.map(|value| (value - zero) / (one - zero));
        Some(match &self.polynomial {
            None => values,
            Some(c) => values.map(|x| c.iter().rev().fold(0.0, |sum, c| sum * x + c)),
        })
    }
}
