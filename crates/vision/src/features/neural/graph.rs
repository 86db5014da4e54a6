//! Writes a network as an ONNX file in memory, for any ONNX runtime; only the operators that XFeat needs.
//!
//! Tensors are named; batch and channels come first (`[1, channels, rows, columns]`). An ONNX file is a protocol-buffer
//! message; the field numbers are those of `onnx.proto` (IR version 8, operator set 13).

pub use crate::features::layers::Convolution;

/// ONNX's IR version: 8 came with operator set 15, and every runtime reads it.
const IR_VERSION: u64 = 8;
/// Version of the operator set.
const OPERATOR_SET: u64 = 13;
/// `TensorProto.DataType.FLOAT`.
const FLOAT: u64 = 1;

/// A network under construction.
#[derive(Default)]
pub struct Graph {
    nodes: Vec<Message>,
    constants: Vec<Message>,
    inputs: Vec<Message>,
    outputs: Vec<Message>,
}

impl Graph {
    /// Adds an input with a number of channels and any number of rows and columns.
    pub fn input(&mut self, name: &str, channels: usize) {
        self.inputs.push(value_info(name, channels));
    }

    /// Declares a tensor as output.
    pub fn output(&mut self, name: &str, channels: usize) {
        self.outputs.push(value_info(name, channels));
    }

    /// `name = convolution(input)`.
    pub fn convolve(&mut self, input: &str, name: &str, convolution: &Convolution) -> String {
        let shape = convolution.shape;
        let weights = self.constant(&format!("{name}.weight"), &shape, &convolution.weights);
        let bias = self.constant(&format!("{name}.bias"), &shape[..1], &convolution.bias);
        let attributes = [
            integers("kernel_shape", &shape[2..]),
            integers("strides", &[convolution.stride; 2]),
            integers("pads", &[convolution.padding; 4]),
        ];
        self.node("Conv", &[input, &weights, &bias], name, &attributes)
    }

    /// `name = max(input, 0)`.
    pub fn relu(&mut self, input: &str, name: &str) -> String {
        self.node("Relu", &[input], name, &[])
    }

    /// `name = 1 / (1 + exp(-input))`.
    pub fn sigmoid(&mut self, input: &str, name: &str) -> String {
        self.node("Sigmoid", &[input], name, &[])
    }

    /// `name = a + b`.
    pub fn add(&mut self, a: &str, b: &str, name: &str) -> String {
        self.node("Add", &[a, b], name, &[])
    }

    /// `name` = input upsampled by `factor` with bilinear interpolation between pixel centres.
    pub fn upsample(&mut self, input: &str, name: &str, factor: usize) -> String {
        let factor = factor as f32;
        let scales = self.constant(&format!("{name}.scales"), &[4], &[1.0, 1.0, factor, factor]);
        let attributes = [text("mode", "linear"), text("coordinate_transformation_mode", "half_pixel")];
        self.node("Resize", &[input, "", &scales], name, &attributes)
    }

    /// The bytes of the ONNX file.
    pub fn write(self) -> Vec<u8> {
        let mut graph = Message::default();
        for node in &self.nodes {
            graph.message(1, node);
        }
        graph.text(2, "driftless");
        for (field, messages) in [(5, &self.constants), (11, &self.inputs), (12, &self.outputs)] {
            for message in messages {
                graph.message(field, message);
            }
        }
        let mut operator_set = Message::default();
        operator_set.text(1, "");
        operator_set.number(2, OPERATOR_SET);
        let mut model = Message::default();
        model.number(1, IR_VERSION);
        model.message(7, &graph);
        model.message(8, &operator_set);
        model.bytes
    }

    fn constant(&mut self, name: &str, shape: &[usize], numbers: &[f32]) -> String {
        let mut tensor = Message::default();
        for &size in shape {
            tensor.number(1, size as u64);
        }
        tensor.number(2, FLOAT);
        tensor.text(8, name);
        let raw: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        tensor.block(9, &raw);
        self.constants.push(tensor);
        name.to_owned()
    }

    fn node(&mut self, operator: &str, inputs: &[&str], output: &str, attributes: &[Message]) -> String {
        let mut node = Message::default();
        for input in inputs {
            node.text(1, input);
        }
        node.text(2, output);
        node.text(3, output);
        node.text(4, operator);
        for attribute in attributes {
            node.message(5, attribute);
        }
        self.nodes.push(node);
        output.to_owned()
    }
}

/// An integer attribute (`AttributeProto`, type INTS).
fn integers(name: &str, values: &[usize]) -> Message {
    let mut attribute = Message::default();
    attribute.text(1, name);
    for &value in values {
        attribute.number(8, value as u64);
    }
    attribute.number(20, 7);
    attribute
}

/// A string attribute (`AttributeProto`, type STRING).
fn text(name: &str, value: &str) -> Message {
    let mut attribute = Message::default();
    attribute.text(1, name);
    attribute.text(4, value);
    attribute.number(20, 3);
    attribute
}

/// A tensor `[1, channels, rows, columns]` (`ValueInfoProto`). Outputs have their own rows and columns.
fn value_info(name: &str, channels: usize) -> Message {
    let fixed = |size: usize| {
        let mut dimension = Message::default();
        dimension.number(1, size as u64);
        dimension
    };
    let named = |axis: &str| {
        let mut dimension = Message::default();
        dimension.text(2, &format!("{name}.{axis}"));
        dimension
    };
    let mut shape = Message::default();
    for dimension in [fixed(1), fixed(channels), named("rows"), named("columns")] {
        shape.message(1, &dimension);
    }
    let mut tensor = Message::default();
    tensor.number(1, FLOAT);
    tensor.message(2, &shape);
    let mut kind = Message::default();
    kind.message(1, &tensor);
    let mut info = Message::default();
    info.text(1, name);
    info.message(2, &kind);
    info
}

/// A protocol-buffer message.
#[derive(Default)]
struct Message {
    bytes: Vec<u8>,
}

impl Message {
    fn number(&mut self, field: u64, value: u64) {
        self.varint(field << 3);
        self.varint(value);
    }

    fn block(&mut self, field: u64, bytes: &[u8]) {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.bytes.extend_from_slice(bytes);
    }

    fn text(&mut self, field: u64, text: &str) {
        self.block(field, text.as_bytes());
    }

    fn message(&mut self, field: u64, message: &Self) {
        self.block(field, &message.bytes);
    }

    /// A varint: seven bits per byte, lowest first; the eighth bit marks that more follow.
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }
}
