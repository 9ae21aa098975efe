//! Small networks as ONNX files, written byte by byte, and the same networks computed plainly: a
//! layer of 3 x 3, a rectifier, and one layer of 1 x 1 for each output.

use mcdpr_vision::grasp::network::Head;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Channels between the two layers.
const HIDDEN: usize = 4;

/// One layer: weights `[to][from][side][side]` and one bias for each channel that comes out.
#[derive(Debug, Clone)]
pub struct Layer {
    pub from: usize,
    pub to: usize,
    pub side: usize,
    pub weights: Vec<f32>,
    pub bias: Vec<f32>,
}

/// A network with one head.
#[derive(Debug, Clone)]
pub struct Net {
    pub first: Layer,
    pub last: Vec<Layer>,
    pub sigmoid: bool,
    pub input: [usize; 4],
}

impl Layer {
    fn drawn(from: usize, to: usize, side: usize, rng: &mut ChaCha8Rng) -> Self {
        let mut draw = |half: f32| half * (2.0 * (rng.next_u32() as f32 / u32::MAX as f32) - 1.0);
        let half = 1.5 / (side as f32 * (from as f32).sqrt());
        Self {
            from,
            to,
            side,
            weights: (0..to * from * side * side).map(|_| draw(half)).collect(),
            bias: (0..to).map(|_| draw(0.3)).collect(),
        }
    }

    /// The layer of a square map with zeros around it, term by term.
    pub fn of(&self, map: &[f32], size: usize) -> Vec<f32> {
        let reach = self.side / 2;
        let mut out = vec![0.0; self.to * size * size];
        for to in 0..self.to {
            for y in 0..size {
                for x in 0..size {
                    let mut sum = f64::from(self.bias[to]);
                    for from in 0..self.from {
                        for i in 0..self.side {
                            for j in 0..self.side {
                                let (row, column) = (y + i, x + j);
                                if row < reach
                                    || column < reach
                                    || row - reach >= size
                                    || column - reach >= size
                                {
                                    continue;
                                }
                                let at = (from * size + row - reach) * size + column - reach;
                                let w = ((to * self.from + from) * self.side + i) * self.side + j;
                                sum += f64::from(self.weights[w]) * f64::from(map[at]);
                            }
                        }
                    }
                    out[(to * size + y) * size + x] = sum as f32;
                }
            }
        }
        out
    }
}

impl Net {
    /// Drawn weights with the shapes of a head.
    pub fn drawn(head: Head, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let input = head.input();
        let first = Layer::drawn(input[1], HIDDEN, 3, &mut rng);
        let outputs = head.outputs();
        let last = outputs
            .iter()
            .map(|shape| Layer::drawn(HIDDEN, shape[1], 1, &mut rng));
        Self {
            first,
            last: last.collect(),
            sigmoid: head == Head::Affga,
            input,
        }
    }

    /// What it gives, computed here.
    pub fn outputs(&self, input: &[f32]) -> Vec<Vec<f32>> {
        let size = self.input[2];
        let mut hidden = self.first.of(input, size);
        for value in &mut hidden {
            *value = value.max(0.0);
        }
        let last = self.last.iter().map(|layer| {
            let mut out = layer.of(&hidden, size);
            if self.sigmoid {
                for value in &mut out {
                    *value = 1.0 / (1.0 + (-*value).exp());
                }
            }
            out
        });
        last.collect()
    }

    /// The network as an ONNX file.
    pub fn file(&self) -> Vec<u8> {
        let mut graph = Vec::new();
        node(&mut graph, "Conv", &["x", "w", "b"], "h", self.first.side);
        node(&mut graph, "Relu", &["h"], "r", 0);
        tensors(&mut graph, "w", "b", &self.first);
        for (index, layer) in self.last.iter().enumerate() {
            let [w, b, z, y] = ["w", "b", "z", "y"].map(|name| format!("{name}{index}"));
            let to = if self.sigmoid { &z } else { &y };
            node(&mut graph, "Conv", &["r", &w, &b], to, layer.side);
            if self.sigmoid {
                node(&mut graph, "Sigmoid", &[&z], &y, 0);
            }
            tensors(&mut graph, &w, &b, layer);
            let shape = [1, layer.to, self.input[2], self.input[3]];
            bytes(&mut graph, 12, &value(&y, &shape));
        }
        bytes(&mut graph, 11, &value("x", &self.input));
        bytes(&mut graph, 2, b"grasps");
        let mut opset = Vec::new();
        number(&mut opset, 2, 13);
        let mut model = Vec::new();
        number(&mut model, 1, 8);
        bytes(&mut model, 8, &opset);
        bytes(&mut model, 7, &graph);
        model
    }
}

fn varint(to: &mut Vec<u8>, mut value: usize) {
    while value >= 0x80 {
        to.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    to.push(value as u8);
}

fn number(to: &mut Vec<u8>, field: usize, value: usize) {
    varint(to, field << 3);
    varint(to, value);
}

fn bytes(to: &mut Vec<u8>, field: usize, value: &[u8]) {
    varint(to, field << 3 | 2);
    varint(to, value.len());
    to.extend_from_slice(value);
}

fn node(graph: &mut Vec<u8>, op: &str, inputs: &[&str], output: &str, side: usize) {
    let mut node = Vec::new();
    for input in inputs {
        bytes(&mut node, 1, input.as_bytes());
    }
    bytes(&mut node, 2, output.as_bytes());
    bytes(&mut node, 3, output.as_bytes());
    bytes(&mut node, 4, op.as_bytes());
    if side > 0 {
        for (name, values) in [("kernel_shape", vec![side; 2]), ("pads", vec![side / 2; 4])] {
            let mut attribute = Vec::new();
            bytes(&mut attribute, 1, name.as_bytes());
            for value in values {
                number(&mut attribute, 8, value);
            }
            // Type: integers.
            number(&mut attribute, 20, 7);
            bytes(&mut node, 5, &attribute);
        }
    }
    bytes(graph, 1, &node);
}

fn tensors(graph: &mut Vec<u8>, weights: &str, bias: &str, layer: &Layer) {
    let shape = [layer.to, layer.from, layer.side, layer.side];
    for (name, shape, values) in [
        (weights, &shape[..], &layer.weights),
        (bias, &shape[..1], &layer.bias),
    ] {
        let mut tensor = Vec::new();
        for dim in shape {
            number(&mut tensor, 1, *dim);
        }
        number(&mut tensor, 2, 1);
        bytes(&mut tensor, 8, name.as_bytes());
        let raw: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        bytes(&mut tensor, 9, &raw);
        bytes(graph, 5, &tensor);
    }
}

fn value(name: &str, shape: &[usize]) -> Vec<u8> {
    let mut dims = Vec::new();
    for dim in shape {
        let mut one = Vec::new();
        number(&mut one, 1, *dim);
        bytes(&mut dims, 1, &one);
    }
    let mut tensor = Vec::new();
    number(&mut tensor, 1, 1);
    bytes(&mut tensor, 2, &dims);
    let mut kind = Vec::new();
    bytes(&mut kind, 1, &tensor);
    let mut info = Vec::new();
    bytes(&mut info, 1, name.as_bytes());
    bytes(&mut info, 2, &kind);
    info
}
