//! The networks as an ONNX graph, for other programs.
//!
//! Inputs, one row per point: `velocity` (world, m/s), `body_rate` (rad/s), `attitude` (roll,
//! pitch, yaw, rad), `input` (u1 in N, u2..u4 in N m). Outputs: `linear_acceleration` (world,
//! m/s^2), `angular_acceleration` (body, rad/s^2). The graph includes features and normalisation.

use prost::Message;

use super::features::{Features, Head, OUTPUTS};
use super::file::ModelFile;
use super::learned::{Network, NetworkModel};

/// Versions of ONNX's file format and of the operators that the graph needs (onnx.ai, 2021).
const IR_VERSION: i64 = 7;
const OPSET: i64 = 13;
const FLOAT: i32 = 1;
const INT64: i32 = 7;

/// The model whose networks are exported; the physics has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Networks {
    /// The two networks alone.
    Net,
    /// The networks on the residual of the physics.
    Hybrid,
}

/// Encodes networks of a model file as an ONNX file; the output of those of `hybrid` adds to the
/// physics' output.
pub fn encode(file: &ModelFile, networks: Networks) -> Vec<u8> {
    let (model, meaning) = match networks {
        Networks::Net => (&file.net, "accelerations"),
        Networks::Hybrid => (&file.residual, "correction to add to the physics' accelerations"),
    };
    let metadata = [
        ("format", "downwash.model".to_owned()),
        ("vehicle", file.vehicle.name.clone()),
        ("outputs", meaning.to_owned()),
        ("frames", "world NED, body FRD, angles roll pitch yaw (z-y-x)".to_owned()),
        ("units", "SI, rad".to_owned()),
    ];
    ModelProto {
        ir_version: IR_VERSION,
        producer_name: "downwash".to_owned(),
        producer_version: env!("CARGO_PKG_VERSION").to_owned(),
        graph: Some(Graph::of(model)),
        opset: vec![OpsetId { domain: String::new(), version: OPSET }],
        metadata: metadata.map(|(key, value)| Entry { key: key.to_owned(), value }).to_vec(),
    }
    .encode_to_vec()
}

/// A rotation in a plane.
#[derive(Clone, Copy)]
struct Turn<'a> {
    /// Its axes: from the first towards the second.
    plane: [usize; 2],
    /// Names of the angle's sine and cosine.
    sin: &'a str,
    cos: &'a str,
}

const YAWED: [usize; 2] = [0, 1];
const PITCHED: [usize; 2] = [2, 0];
const ROLLED: [usize; 2] = [1, 2];

/// A graph under construction.
#[derive(Default)]
struct Graph {
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
}

impl Graph {
    fn of(model: &NetworkModel) -> GraphProto {
        let mut graph = Self::default();
        let angle = |graph: &mut Self, i: i64, op: &str| {
            let angle = graph.column("attitude", i);
            graph.node(op, &[&angle])
        };
        // Sine and cosine of roll, pitch, yaw.
        let sines: Vec<String> = (0..3).map(|i| angle(&mut graph, i, "Sin")).collect();
        let cosines: Vec<String> = (0..3).map(|i| angle(&mut graph, i, "Cos")).collect();
        // Rotations from the world to the features' axes, in sequence.
        let about = |plane, i: usize| Turn { plane, sin: &sines[i], cos: &cosines[i] };
        let turns: Vec<Turn<'_>> = match model.features {
            Features::World => Vec::new(),
            Features::Heading => vec![about(YAWED, 2)],
            Features::Body => vec![about(YAWED, 2), about(PITCHED, 1), about(ROLLED, 0)],
        };
        let velocity = turns
            .iter()
            .fold("velocity".to_owned(), |vector, turn| graph.turned(&vector, *turn, false));
        let tilt: Vec<String> = match model.features {
            Features::World => [&sines[..], &cosines[..]].concat(),
            Features::Heading => [&sines[..2], &cosines[..2]].concat(),
            Features::Body => vec![
                graph.node("Neg", &[&sines[1]]),
                graph.node("Mul", &[&cosines[1], &sines[0]]),
                graph.node("Mul", &[&cosines[1], &cosines[0]]),
            ],
        };
        let mut results = Vec::new();
        for (head, network) in [(Head::Linear, &model.linear), (Head::Angular, &model.angular)] {
            let columns: &[i64] = match head {
                Head::Linear => &[0],
                Head::Angular => &[1, 2, 3],
            };
            let input = graph.columns("input", columns);
            let mut parts = vec![velocity.as_str(), "body_rate"];
            parts.extend(tilt.iter().map(String::as_str));
            parts.push(&input);
            let features = graph.node("Concat", &parts);
            results.push(graph.network(network, &features));
        }
        for turn in turns.iter().rev() {
            results[0] = graph.turned(&results[0], *turn, true);
        }
        let outputs = ["linear_acceleration", "angular_acceleration"];
        for (name, result) in outputs.iter().zip(&results) {
            graph.nodes.push(NodeProto {
                inputs: vec![result.clone()],
                outputs: vec![(*name).to_owned()],
                name: (*name).to_owned(),
                op_type: "Identity".to_owned(),
                attributes: Vec::new(),
            });
        }
        let inputs = [("velocity", 3), ("body_rate", 3), ("attitude", 3), ("input", 4)];
        GraphProto {
            nodes: graph.nodes,
            name: "accelerations".to_owned(),
            constants: graph.constants,
            inputs: inputs.map(|(name, width)| value_info(name, width)).to_vec(),
            outputs: outputs.map(|name| value_info(name, OUTPUTS as i64)).to_vec(),
        }
    }

    /// Adds a node; returns the name of its output.
    fn node(&mut self, op_type: &str, inputs: &[&str]) -> String {
        let name = format!("{}_{}", op_type.to_lowercase(), self.nodes.len());
        let joins_columns = matches!(op_type, "Concat" | "Gather");
        let axis = Attribute { name: "axis".to_owned(), int: 1, kind: 2 };
        self.nodes.push(NodeProto {
            inputs: inputs.iter().map(|input| (*input).to_owned()).collect(),
            outputs: vec![name.clone()],
            name: name.clone(),
            op_type: op_type.to_owned(),
            attributes: if joins_columns { vec![axis] } else { Vec::new() },
        });
        name
    }

    fn constant(&mut self, dims: &[usize], values: impl Iterator<Item = f64>) -> String {
        let name = format!("constant_{}", self.constants.len());
        self.constants.push(TensorProto {
            dims: dims.iter().map(|n| *n as i64).collect(),
            data_type: FLOAT,
            name: name.clone(),
            raw_data: values.flat_map(|v| (v as f32).to_le_bytes()).collect(),
        });
        name
    }

    /// Gathers columns of a matrix.
    fn columns(&mut self, of: &str, columns: &[i64]) -> String {
        let name = format!("constant_{}", self.constants.len());
        self.constants.push(TensorProto {
            dims: vec![columns.len() as i64],
            data_type: INT64,
            name: name.clone(),
            raw_data: columns.iter().flat_map(|c| c.to_le_bytes()).collect(),
        });
        self.node("Gather", &[of, &name])
    }

    fn column(&mut self, of: &str, column: i64) -> String {
        self.columns(of, &[column])
    }

    /// A vector rotated in a plane, `forwards` or back.
    fn turned(&mut self, vector: &str, turn: Turn<'_>, forwards: bool) -> String {
        let Turn { plane, sin, cos } = turn;
        let mut parts: [String; 3] = std::array::from_fn(|i| self.column(vector, i as i64));
        let [x, y] = plane.map(|axis| parts[axis].clone());
        let cx = self.node("Mul", &[cos, &x]);
        let sy = self.node("Mul", &[sin, &y]);
        let cy = self.node("Mul", &[cos, &y]);
        let sx = self.node("Mul", &[sin, &x]);
        let (first, second) = if forwards { ("Sub", "Add") } else { ("Add", "Sub") };
        parts[plane[0]] = self.node(first, &[&cx, &sy]);
        parts[plane[1]] = self.node(second, &[&cy, &sx]);
        self.node("Concat", &[&parts[0], &parts[1], &parts[2]])
    }

    fn network(&mut self, network: &Network, features: &str) -> String {
        let Network { inputs, outputs, mlp } = network;
        let singles = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        // ONNX multiplies row vectors from the left, so the weights are transposed.
        let transposed = |values: &[f32], columns: usize| -> Vec<f64> {
            let rows = values.len() / columns;
            (0..columns * rows).map(|i| f64::from(values[i % rows * columns + i / rows])).collect()
        };
        let layer = |graph: &mut Self, x: &str, weights: &[f32], from: usize, biases: &[f32]| {
            let shape = [from, biases.len()];
            let weights = graph.constant(&shape, transposed(weights, from).into_iter());
            let biases = graph.constant(&[biases.len()], singles(biases).into_iter());
            let product = graph.node("MatMul", &[x, &weights]);
            graph.node("Add", &[&product, &biases])
        };
        let mean = self.constant(&[mlp.inputs], inputs.mean.iter().copied());
        let deviation = self.constant(&[mlp.inputs], inputs.deviation.iter().copied());
        let centred = self.node("Sub", &[features, &mean]);
        let x = self.node("Div", &[&centred, &deviation]);
        let hidden = layer(self, &x, &mlp.hidden_weights, mlp.inputs, &mlp.hidden_biases);
        let hidden = self.node("Relu", &[&hidden]);
        let y = layer(self, &hidden, &mlp.output_weights, mlp.hidden, &mlp.output_biases);
        let deviation = self.constant(&[OUTPUTS], outputs.deviation.iter().copied());
        let mean = self.constant(&[OUTPUTS], outputs.mean.iter().copied());
        let scaled = self.node("Mul", &[&y, &deviation]);
        self.node("Add", &[&scaled, &mean])
    }
}

/// A matrix with any number of rows.
fn value_info(name: &str, width: i64) -> ValueInfo {
    let rows = Dimension { value: None, parameter: Some("points".to_owned()) };
    let columns = Dimension { value: Some(width), parameter: None };
    let shape = Some(Shape { dimensions: vec![rows, columns] });
    let tensor = Some(TensorType { element: FLOAT, shape });
    ValueInfo { name: name.to_owned(), kind: Some(TypeProto { tensor }) }
}

// The subset of ONNX's protobuf messages that this file writes; tags are those of onnx.proto.

#[derive(Clone, PartialEq, Message)]
struct ModelProto {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(string, tag = "2")]
    producer_name: String,
    #[prost(string, tag = "3")]
    producer_version: String,
    #[prost(message, optional, tag = "7")]
    graph: Option<GraphProto>,
    #[prost(message, repeated, tag = "8")]
    opset: Vec<OpsetId>,
    #[prost(message, repeated, tag = "14")]
    metadata: Vec<Entry>,
}

#[derive(Clone, PartialEq, Message)]
struct OpsetId {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

#[derive(Clone, PartialEq, Message)]
struct Entry {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

#[derive(Clone, PartialEq, Message)]
struct GraphProto {
    #[prost(message, repeated, tag = "1")]
    nodes: Vec<NodeProto>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    constants: Vec<TensorProto>,
    #[prost(message, repeated, tag = "11")]
    inputs: Vec<ValueInfo>,
    #[prost(message, repeated, tag = "12")]
    outputs: Vec<ValueInfo>,
}

#[derive(Clone, PartialEq, Message)]
struct NodeProto {
    #[prost(string, repeated, tag = "1")]
    inputs: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    outputs: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    op_type: String,
    #[prost(message, repeated, tag = "5")]
    attributes: Vec<Attribute>,
}

#[derive(Clone, PartialEq, Message)]
struct Attribute {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(int64, tag = "3")]
    int: i64,
    #[prost(int32, tag = "20")]
    kind: i32,
}

#[derive(Clone, PartialEq, Message)]
struct TensorProto {
    #[prost(int64, repeated, tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(string, tag = "8")]
    name: String,
    #[prost(bytes = "vec", tag = "9")]
    raw_data: Vec<u8>,
}

#[derive(Clone, PartialEq, Message)]
struct ValueInfo {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    kind: Option<TypeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TypeProto {
    #[prost(message, optional, tag = "1")]
    tensor: Option<TensorType>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorType {
    #[prost(int32, tag = "1")]
    element: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<Shape>,
}

#[derive(Clone, PartialEq, Message)]
struct Shape {
    #[prost(message, repeated, tag = "1")]
    dimensions: Vec<Dimension>,
}

#[derive(Clone, PartialEq, Message)]
struct Dimension {
    #[prost(int64, optional, tag = "1")]
    value: Option<i64>,
    #[prost(string, optional, tag = "2")]
    parameter: Option<String>,
}
