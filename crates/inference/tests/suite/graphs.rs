//! Small graphs that use every operator the builder has, with random weights.

use dermis_inference::Interface;
use dermis_inference::onnx::{Element, GraphBuilder, Value, Window};

/// What a graph computes, written out in f64.
type Oracle = Box<dyn Fn(&[f32]) -> Vec<f64>>;

pub struct Graph {
    pub name: &'static str,
    pub bytes: Vec<u8>,
    pub interface: Interface,
    pub oracle: Option<Oracle>,
}

/// Uniform numbers in \[-1, 1\], the same in every run.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1 << 23) as f32 - 1.0
    }

    /// A whole number below `end`.
    pub fn below(&mut self, end: usize) -> usize {
        ((f64::from(self.next()) + 1.0) / 2.0 * end as f64) as usize
    }

    pub fn take(&mut self, count: usize) -> Vec<f32> {
        (0..count).map(|_| self.next()).collect()
    }
}

pub fn all() -> Vec<Graph> {
    vec![mlp(), support_vectors(), neighbours(), convolution(), deconvolution(), pieces()]
}

/// Three layers, one of each activation.
pub fn mlp() -> Graph {
    let mut random = Random::new(1);
    let sizes = [5, 8, 7, 6, 3];
    let mut g = GraphBuilder::new("mlp");
    let mut x = g.input("input", &[1, sizes[0]]);
    let mut layers = Vec::new();
    for (i, pair) in sizes.windows(2).enumerate() {
        let (w, b) = (random.take(pair[0] * pair[1]), random.take(pair[1]));
        let weight = g.constant(&format!("w{i}"), pair, &w);
        let bias = g.constant(&format!("b{i}"), &[pair[1]], &b);
        x = g.gemm(&x, &weight, Some(&bias));
        x = match i {
            0 => g.tanh(&x),
            1 => g.relu(&x),
            2 => g.sigmoid(&x),
            _ => x,
        };
        layers.push((w, b));
    }
    g.output("output", &x, &[1, 3]);
    let oracle = move |input: &[f32]| {
        let mut x: Vec<f64> = input.iter().map(|v| f64::from(*v)).collect();
        for (i, (w, b)) in layers.iter().enumerate() {
            x = (0..b.len())
                .map(|o| {
                    let sum: f64 = x.iter().enumerate().map(|(k, v)| v * f64::from(w[k * b.len() + o])).sum();
                    let sum = sum + f64::from(b[o]);
                    match i {
                        0 => sum.tanh(),
                        1 => sum.max(0.0),
                        2 => 1.0 / (1.0 + (-sum).exp()),
                        _ => sum,
                    }
                })
                .collect();
        }
        x
    };
    Graph {
        name: "mlp",
        bytes: g.finish().unwrap(),
        interface: Interface::flat(5, 3),
        oracle: Some(Box::new(oracle)),
    }
}

/// Support-vector regression with a Gaussian kernel, in 64-bit floats:
/// `Σ coefficientᵢ exp(−γ‖x − vᵢ‖²) + ρ`, with the square written out.
fn support_vectors() -> Graph {
    let mut random = Random::new(2);
    let (inputs, vectors, gamma, rho) = (4, 9, 0.7, 0.25);
    let double = |v: Vec<f32>| v.into_iter().map(f64::from).collect::<Vec<_>>();
    let support = double(random.take(inputs * vectors));
    let coefficients = double(random.take(vectors));
    let transposed: Vec<f64> = (0..inputs)
        .flat_map(|i| (0..vectors).map(move |v| (i, v)))
        .map(|(i, v)| -2.0 * support[v * inputs + i])
        .collect();
    let squares: Vec<f64> = support.chunks(inputs).map(|v| v.iter().map(|x| x * x).sum()).collect();

    let mut g = GraphBuilder::new("svr");
    let x = g.input("input", &[1, inputs]);
    let x = g.cast(&x, Element::F64);
    let vectors_t = g.constant_f64("vectors", &[inputs, vectors], &transposed);
    let vector_squares = g.constant_f64("squares", &[1, vectors], &squares);
    let minus_gamma = g.constant_f64("gamma", &[1], &[-gamma]);
    let weights = g.constant_f64("coefficients", &[vectors, 1], &coefficients);
    let offset = g.constant_f64("rho", &[1], &[rho]);
    let square = g.mul(&x, &x);
    let square = g.reduce_sum(&square, 1);
    let cross = g.matmul(&x, &vectors_t);
    let distance = g.add(&square, &cross);
    let distance = g.add(&distance, &vector_squares);
    let exponent = g.mul(&distance, &minus_gamma);
    let kernel = g.exp(&exponent);
    let y = g.matmul(&kernel, &weights);
    let y = g.add(&y, &offset);
    let y = g.cast(&y, Element::F32);
    g.output("output", &y, &[1, 1]);
    let oracle = move |input: &[f32]| {
        let kernels = support.chunks(inputs).map(|v| {
            let distance: f64 = v.iter().zip(input).map(|(v, x)| (v - f64::from(*x)).powi(2)).sum();
            (-gamma * distance).exp()
        });
        vec![kernels.zip(&coefficients).map(|(k, c)| k * c).sum::<f64>() + rho]
    };
    Graph {
        name: "svr",
        bytes: g.finish().unwrap(),
        interface: Interface::flat(inputs, 1),
        oracle: Some(Box::new(oracle)),
    }
}

/// Mean target of the three nearest neighbours.
fn neighbours() -> Graph {
    let mut random = Random::new(3);
    let (inputs, points, targets, k) = (3, 20, 2, 3);
    let data = random.take(points * inputs);
    let answers = random.take(points * targets);
    let transposed: Vec<f32> = (0..inputs)
        .flat_map(|i| (0..points).map(move |p| (i, p)))
        .map(|(i, p)| -2.0 * data[p * inputs + i])
        .collect();
    let squares: Vec<f32> = data.chunks(inputs).map(|v| v.iter().map(|x| x * x).sum()).collect();
    let mut g = GraphBuilder::new("knn");
    let x = g.input("input", &[1, inputs]);
    let points_t = g.constant("points", &[inputs, points], &transposed);
    let point_squares = g.constant("squares", &[1, points], &squares);
    let targets_all = g.constant("targets", &[points, targets], &answers);
    let distance = g.matmul(&x, &points_t);
    let distance = g.add(&distance, &point_squares);
    let (_, nearest) = g.top_k(&distance, k, 1, false);
    let found = g.gather(&targets_all, &nearest, 0);
    let mean = g.reduce_mean(&found, 1);
    let mean = g.reshape(&mean, &[1, targets]);
    g.output("output", &mean, &[1, targets]);
    let oracle = move |input: &[f32]| {
        let distance =
            |p: &[f32]| -> f64 { p.iter().zip(input).map(|(p, x)| f64::from(p - x).powi(2)).sum() };
        let mut order: Vec<usize> = (0..points).collect();
        order.sort_by(|a, b| {
            distance(&data[a * inputs..(a + 1) * inputs])
                .total_cmp(&distance(&data[b * inputs..(b + 1) * inputs]))
        });
        (0..targets)
            .map(|t| order[..3].iter().map(|p| f64::from(answers[p * targets + t])).sum::<f64>() / 3.0)
            .collect()
    };
    Graph {
        name: "knn",
        bytes: g.finish().unwrap(),
        interface: Interface::flat(inputs, targets),
        oracle: Some(Box::new(oracle)),
    }
}

/// An image through strided convolutions, batch normalisation and a dense layer.
fn convolution() -> Graph {
    let mut random = Random::new(4);
    let mut g = GraphBuilder::new("cnn");
    let x = g.input("input", &[1, 2, 9, 11]);
    let w1 = g.constant("w1", &[4, 2, 3, 3], &random.take(4 * 2 * 9));
    let b1 = g.constant("b1", &[4], &random.take(4));
    let window = Window { strides: vec![2, 2], pads: vec![1, 1, 1, 1] };
    let h = g.conv(&x, &w1, Some(&b1), &window);
    let statistics: Vec<Value> = [0.0, 0.0, 0.0, 1.5]
        .iter()
        .enumerate()
        .map(|(i, offset)| {
            let values: Vec<f32> = random.take(4).iter().map(|v| v + offset).collect();
            g.constant(&format!("norm{i}"), &[4], &values)
        })
        .collect();
    let h = g.batch_norm(&h, &statistics[0], &statistics[1], &statistics[2], &statistics[3], 1e-5);
    let h = g.relu(&h);
    let h = g.reshape(&h, &[1, 4 * 5 * 6]);
    let w2 = g.constant("w2", &[120, 3], &random.take(360));
    let y = g.gemm(&h, &w2, None);
    g.output("output", &y, &[1, 3]);
    Graph {
        name: "cnn",
        bytes: g.finish().unwrap(),
        interface: Interface { input_shape: vec![1, 2, 9, 11], ..Interface::flat(1, 3) },
        oracle: None,
    }
}

/// A vector that becomes an image.
fn deconvolution() -> Graph {
    let mut random = Random::new(5);
    let mut g = GraphBuilder::new("deconv");
    let x = g.input("input", &[1, 6]);
    let w = g.constant("w", &[6, 3 * 4 * 4], &random.take(6 * 48));
    let h = g.matmul(&x, &w);
    let h = g.reshape(&h, &[1, 3, 4, 4]);
    let kernel = g.constant("kernel", &[3, 2, 3, 3], &random.take(3 * 2 * 9));
    let bias = g.constant("bias", &[2], &random.take(2));
    let window = Window { strides: vec![2, 2], pads: vec![1, 1, 1, 1] };
    let y = g.conv_transpose(&h, &kernel, Some(&bias), &window, &[1, 1]);
    g.output("output", &y, &[1, 2, 8, 8]);
    Graph {
        name: "deconv",
        bytes: g.finish().unwrap(),
        interface: Interface { output_shape: vec![1, 2, 8, 8], ..Interface::flat(6, 1) },
        oracle: None,
    }
}

/// The rest: `[−(a−b)/(1+c²), √(c²), b[0]]` of an input split into a, b, c.
fn pieces() -> Graph {
    let mut g = GraphBuilder::new("pieces");
    let x = g.input("input", &[1, 6]);
    let parts = g.split(&x, 1, &[2, 2, 2]);
    let square = g.mul(&parts[2], &parts[2]);
    let one = g.constant("one", &[1], &[1.0]);
    let below = g.add(&square, &one);
    let difference = g.sub(&parts[0], &parts[1]);
    let ratio = g.div(&difference, &below);
    let ratio = g.neg(&ratio);
    let root = g.sqrt(&square);
    let first = g.slice(&parts[1], 1, 0, 1);
    let y = g.concat(&[&ratio, &root, &first], 1);
    g.output("output", &y, &[1, 5]);
    let oracle = |input: &[f32]| {
        let x: Vec<f64> = input.iter().map(|v| f64::from(*v)).collect();
        let ratio = |i: usize| -(x[i] - x[i + 2]) / (1.0 + x[i + 4].powi(2));
        vec![ratio(0), ratio(1), x[4].abs(), x[5].abs(), x[2]]
    };
    Graph {
        name: "pieces",
        bytes: g.finish().unwrap(),
        interface: Interface::flat(6, 5),
        oracle: Some(Box::new(oracle)),
    }
}
