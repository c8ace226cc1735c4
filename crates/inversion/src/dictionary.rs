//! Signals of single contacts at locations all over a surface: where a search begins, and what a weak signal can mean.
//!
//! The dictionary holds single contacts only, so it is exact for one contact on every model. For several contacts it says where to
//! start: the next contact is looked for in what the model itself leaves of all contacts found so far, and all of them are then
//! refined together on the model ([`Problem::minimise`](crate::fit::Problem::minimise)). Only [`Pairs`](crate::pairs::Pairs) and
//! [`Inverter::sparse`](crate::Inverter::sparse) add its signals up. Each asks
//! [`ForwardModel::superposes`] first.
//!
//! Where shear is looked for and every place has a pattern of its own, a place stands for presses there that lean, too (matched subspace detector; L. L.
//! Scharf and B. Friedlander, *IEEE Trans. Signal Process.* 42 (1994) 2146). Shear counts against such a press by its square, in units of what is
//! expected. Among straight presses alone, one that leans looks most like another some millimetres away.

use dermis_model::{ForwardModel, Stimulus, Unknowns, Untouched, in_parallel, tangents};
use dermis_skin::{ModelError, Surface};
use nalgebra::{DMatrix, Matrix3, Point3, Vector3};

use crate::settings::{Search, Settings};

/// Shares of the largest force at which responses are kept: a soft medium is not quite linear in it.
const LEVELS: [f64; 4] = [0.05, 0.2, 0.5, 1.0];

/// One place of the surface.
#[derive(Debug, Clone)]
pub(crate) struct Location {
    pub position: Point3<f64>,
    pub normal: Vector3<f64>,
    /// \[m²\] of the surface that it stands for.
    pub area: f64,
}

/// Responses of a normal press at locations × levels.
#[derive(Debug)]
pub(crate) struct Dictionary {
    pub locations: Vec<Location>,
    /// \[N\] of the levels.
    pub forces: Vec<f64>,
    channels: usize,
    /// locations × levels × channels, gains included, in the unit of the skin.
    responses: Vec<f32>,
    /// locations × channels: direction of the response at [`SHAPE`] in units of the noise.
    directions: Vec<f32>,
    /// The same at [`LIGHT`], where each place has a pattern of its own; empty elsewhere.
    light: Vec<f32>,
    /// What shear adds to the directions, where it is looked for and every place has a pattern of its own.
    shears: Option<Shears>,
    /// For every place the locations beside it.
    neighbours: Vec<Vec<usize>>,
    /// For every place its [`mismatch`](Self::mismatch).
    mismatches: Vec<f64>,
}

/// What a dictionary has of one place.
#[derive(Debug, Default)]
struct Place {
    responses: Vec<f32>,
    direction: Vec<f32>,
    light: Vec<f32>,
    shear: Option<(Vec<f32>, Matrix3<f64>)>,
}

/// What shear changes at every place.
#[derive(Debug)]
struct Shears {
    /// locations × 2 × channels, in units of the noise: together with the direction of a straight press an orthonormal basis of the responses to all
    /// presses at a place.
    directions: Vec<f32>,
    /// For every place the responses to a pressing force and to a shear along either tangent, each as large as that of the directions, in this basis:
    /// columns of an upper triangle.
    triangles: Vec<Matrix3<f64>>,
    /// Standard deviation of shear along each direction over the pressing force; any is as likely where absent.
    expected: Option<f64>,
}

impl Shears {
    /// Both directions of a place, end to end, and its triangle; `straight` is the whitened response to a press of `force` \[N\] there.
    fn at(
        location: &Location,
        (straight, force): (&[f64], f64),
        whitened: impl Fn(Vector3<f64>) -> Result<Vec<f64>, ModelError>,
    ) -> Result<(Vec<f32>, Matrix3<f64>), ModelError> {
        let mut columns = DMatrix::zeros(straight.len(), 3);
        columns.column_mut(0).copy_from_slice(straight);
        for (k, axis) in tangents(&location.normal).iter().enumerate() {
            let leaning = whitened((axis * LEAN - location.normal) * force)?;
            let changes = leaning.iter().zip(straight).map(|(leaning, straight)| (leaning - straight) / LEAN);
            columns.column_mut(k + 1).iter_mut().zip(changes).for_each(|(value, change)| *value = change);
        }
        let factors = columns.qr();
        let (mut q, mut r) = (factors.q(), factors.r());
        // The first direction is that of the press itself.
        if r[(0, 0)] < 0.0 {
            q.column_mut(0).neg_mut();
            r.row_mut(0).neg_mut();
        }
        let directions = q.columns(1, 2).iter().map(|value| *value as f32).collect();
        Ok((directions, r.fixed_view::<3, 3>(0, 0).into_owned()))
    }

    /// The press that makes these parts of residuals along the three directions of a place: what it explains of their square, its shear counted
    /// against it, and both shears over the pressing force. `None` where it would pull, or slip.
    fn press(&self, location: usize, parts: &Vector3<f64>) -> Option<(f64, [f64; 2])> {
        let forces = self.triangles[location].solve_upper_triangular(parts)?;
        let lean = [forces.y / forces.x, forces.z / forces.x];
        let square = lean[0] * lean[0] + lean[1] * lean[1];
        let unexpected = self.expected.map_or(0.0, |share| square / (share * share));
        let stands = forces.x > 0.0 && square <= STEEPEST * STEEPEST;
        stands.then_some((parts.norm_squared() - unexpected, lean))
    }
}

/// Spacings within which locations are neighbours.
const BESIDE: f64 = 2.0;

/// Shear over the pressing force by which a press is leant to see what shear does.
const LEAN: f64 = 0.1;
/// Shear over the pressing force at most: beyond, tips slip.
const STEEPEST: f64 = 1.0;

/// Level whose response stands for the others where only its shape matters.
pub(crate) const SHAPE: usize = 1;
/// Level at which presses are so light that they must stand out by their shape: where each place has a pattern of its own, that may change as forces
/// grow, and strong presses show whatever they are compared with.
const LIGHT: usize = 0;

impl Dictionary {
    /// \[m²\] largest variance along any direction of a place that is anywhere on the surface.
    pub fn variance(&self) -> f64 {
        let area: f64 = self.locations.iter().map(|l| l.area).sum();
        let mean = self.locations.iter().map(|l| l.position.coords * l.area).sum::<Vector3<f64>>() / area;
        let spread = |l: &Location| {
            let away = l.position.coords - mean;
            away * away.transpose() * (l.area / area)
        };
        self.locations.iter().map(spread).sum::<Matrix3<f64>>().symmetric_eigenvalues().max()
    }

    /// Locations about `spacing` \[m\] apart, out of the points of the model's surface; on its middle line along x where only
    /// x is looked for, and within a region where one is given.
    pub fn new(
        model: &dyn ForwardModel,
        (line, region): (Option<f64>, Option<[[f64; 3]; 2]>),
        spacing: f64,
        settings: &Settings,
        gains: &[f64],
    ) -> Result<Self, ModelError> {
        let mut locations = thin(model.surface(), line, spacing);
        if let Some([low, high]) = region {
            locations.retain(|p| (0..3).all(|k| (low[k]..=high[k]).contains(&p.position[k])));
        }
        let forces: Vec<f64> = LEVELS.iter().map(|share| share * settings.force_max).collect();
        let channels = model.channels();
        let untouched = Untouched::of(model)?;
        let signal = |location: &Location, force: Vector3<f64>| -> Result<Vec<f64>, ModelError> {
            let mut out = vec![0.0; channels];
            let contacts = vec![settings.indentation(location.position, force)];
            model.response(&Stimulus { contacts, ..Stimulus::default() }, &mut out)?;
            untouched.subtract(&mut out);
            out.iter_mut().zip(gains).for_each(|(o, gain)| *o *= gain);
            Ok(out)
        };
        let whitened =
            |signal: Vec<f64>| -> Vec<f64> { signal.iter().zip(model.noise()).map(|(v, n)| v / n).collect() };
        let leans = settings.search == Search::Near && settings.unknowns == Unknowns::Full && channels >= 3;
        let unit = |whitened: &[f64]| -> Vec<f32> {
            let length = whitened.iter().map(|v| v * v).sum::<f64>().sqrt();
            whitened.iter().map(|v| if length > 0.0 { v / length } else { 0.0 } as f32).collect()
        };
        let place = |location: &Location| -> Result<Place, ModelError> {
            let mut place = Place::default();
            for (level, force) in forces.iter().enumerate() {
                let out = signal(location, -location.normal * *force)?;
                place.responses.extend(out.iter().map(|v| *v as f32));
                if level == LIGHT && settings.search == Search::Near {
                    place.light = unit(&whitened(out));
                } else if level == SHAPE {
                    let straight = whitened(out);
                    place.direction = unit(&straight);
                    if leans {
                        let by_force = |force| Ok(whitened(signal(location, force)?));
                        place.shear = Some(Shears::at(location, (&straight, *force), by_force)?);
                    }
                }
            }
            Ok(place)
        };
        let mut responses = Vec::with_capacity(locations.len() * forces.len() * channels);
        let mut directions = Vec::with_capacity(locations.len() * channels);
        let mut light = Vec::new();
        let (mut sheared, mut triangles) = (Vec::new(), Vec::new());
        for place in in_parallel(locations.len(), |i| place(&locations[i])) {
            let place = place?;
            responses.extend(place.responses);
            directions.extend(place.direction);
            light.extend(place.light);
            if let Some((directions, triangle)) = place.shear {
                sheared.extend(directions);
                triangles.push(triangle);
            }
        }
        let shears = leans.then_some(Shears { directions: sheared, triangles, expected: settings.shear });
        let neighbours = beside(&locations, BESIDE * spacing);
        let mismatches =
            neighbours.iter().enumerate().map(|(i, all)| mismatch(&directions, channels, i, all));
        let mismatches = mismatches.collect();
        Ok(Self { locations, forces, channels, responses, directions, light, shears, neighbours, mismatches })
    }

    /// Locations beside a place.
    pub fn neighbours(&self, location: usize) -> &[usize] {
        &self.neighbours[location]
    }

    /// Share of the square of a place's response that the response of a neighbour does not explain: the most of all neighbours.
    /// A touch between locations leaves no more than that where the nearest place is taken for its own.
    pub fn mismatch(&self, location: usize) -> f64 {
        self.mismatches[location]
    }

    /// For every place the part of whitened residuals that lies along its response, 0 where it points the other way.
    pub fn project<'a>(&'a self, residuals: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
        self.directions.chunks_exact(self.channels).map(move |direction| dot(direction, residuals).max(0.0))
    }

    /// The length of what the best place explains of whitened residuals, by a press of [`SHAPE`] or a light one.
    pub fn clearest(&self, residuals: &[f32]) -> f32 {
        let light = self.light.chunks_exact(self.channels).map(|direction| dot(direction, residuals));
        self.project(residuals).chain(light).fold(0.0, f32::max)
    }

    /// For every place the length of what a press there explains of whitened residuals: a straight one, or one that leans where that explains more
    /// although its shear counts against it; 0 where it would pull.
    pub fn explained<'a>(&'a self, residuals: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
        let project = self.project(residuals).enumerate();
        project.map(move |(location, straight)| self.leaning(location, straight, residuals).0)
    }

    /// Both shears over the pressing force of the press at a place that explains whitened residuals best.
    pub fn lean(&self, location: usize, residuals: &[f32]) -> [f64; 2] {
        self.leaning(location, dot(self.direction(location), residuals), residuals).1
    }

    /// What [`explained`](Self::explained) and [`lean`](Self::lean) say of a place; `straight` is its direction's part of the residuals.
    fn leaning(&self, location: usize, straight: f32, residuals: &[f32]) -> (f32, [f64; 2]) {
        let Some(shears) = self.shears.as_ref().filter(|_| straight > 0.0) else {
            return (straight, [0.0; 2]);
        };
        let part = |k: usize| {
            let start = (2 * location + k) * self.channels;
            f64::from(dot(&shears.directions[start..start + self.channels], residuals))
        };
        let parts = Vector3::new(f64::from(straight), part(0), part(1));
        match shears.press(location, &parts) {
            Some((square, lean)) if square > parts.x * parts.x => (square.sqrt() as f32, lean),
            _ => (straight, [0.0; 2]),
        }
    }

    /// Unit direction of every place's response in units of the noise, end to end; 0 for a place that no channel responds to.
    pub fn directions(&self) -> &[f32] {
        &self.directions
    }

    /// Unit direction of one place's response in units of the noise.
    pub fn direction(&self, location: usize) -> &[f32] {
        &self.directions[location * self.channels..(location + 1) * self.channels]
    }

    /// Response of a place at a level, gains included, in the unit of the skin.
    pub fn response(&self, location: usize, level: usize) -> &[f32] {
        let start = (location * self.forces.len() + level) * self.channels;
        &self.responses[start..start + self.channels]
    }
}

/// Sums that a product is added up in, side by side: one sum alone waits for each of its additions.
const LANES: usize = 16;

fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0_f32; LANES];
    for (a, b) in a.iter().zip(b) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    sums.iter().sum::<f32>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f32>()
}

/// Points of a surface with their normals, so that none is nearer than `spacing` to another; each stands for its own area and that of
/// the points that it kept out: a point counts with the place that is nearest to it when its turn comes.
fn thin(surface: &Surface, line: Option<f64>, spacing: f64) -> Vec<Location> {
    let cell = |p: &Point3<f64>| p.coords.map(|v| (v / spacing).floor() as i64);
    let mut cells = std::collections::BTreeMap::<[i64; 3], Vec<usize>>::new();
    let mut locations: Vec<Location> = Vec::new();
    for ((point, normal), area) in surface.points.iter().zip(&surface.normals).zip(&surface.areas) {
        let point = &line.map_or(*point, |y| Point3::new(point.x, y, point.z));
        let at = cell(point);
        let mut nearest: Option<(f64, usize)> = None;
        for dx in -1..=1 {
            for dy in -1..=1 {
                for dz in -1..=1 {
                    for &other in cells.get(&[at.x + dx, at.y + dy, at.z + dz]).into_iter().flatten() {
                        let distance = (locations[other].position - point).norm();
                        if nearest.is_none_or(|(d, _)| distance < d) {
                            nearest = Some((distance, other));
                        }
                    }
                }
            }
        }
        match nearest {
            // A hair less, so that rounding does not thin out a grid whose pitch is the spacing.
            Some((distance, other)) if distance < spacing * 0.999 => locations[other].area += area,
            _ => {
                cells.entry([at.x, at.y, at.z]).or_default().push(locations.len());
                locations.push(Location { position: *point, normal: *normal, area: *area });
            }
        }
    }
    locations
}

/// Share of the square of a unit direction that the worst of its neighbours does not explain.
fn mismatch(directions: &[f32], channels: usize, location: usize, neighbours: &[usize]) -> f64 {
    let direction = |i: usize| &directions[i * channels..(i + 1) * channels];
    let own = direction(location);
    let unexplained = |other: &usize| {
        let cosine = dot(own, direction(*other));
        1.0 - f64::from(cosine.clamp(0.0, 1.0)).powi(2)
    };
    neighbours.iter().map(unexplained).fold(0.0, f64::max)
}

/// For every place all others that are nearer than `distance` \[m\].
fn beside(locations: &[Location], distance: f64) -> Vec<Vec<usize>> {
    let cell = |p: &Point3<f64>| p.coords.map(|v| (v / distance).floor() as i64);
    let mut cells = std::collections::BTreeMap::<[i64; 3], Vec<usize>>::new();
    for (index, location) in locations.iter().enumerate() {
        let at = cell(&location.position);
        cells.entry([at.x, at.y, at.z]).or_default().push(index);
    }
    let around = |index: usize| {
        let location = &locations[index];
        let at = cell(&location.position);
        let offsets = || -1..=1;
        let near = offsets()
            .flat_map(|dx| offsets().flat_map(move |dy| offsets().map(move |dz| [dx, dy, dz])))
            .filter_map(|d| cells.get(&[at.x + d[0], at.y + d[1], at.z + d[2]]));
        near.flatten()
            .copied()
            .filter(|other| {
                *other != index && (locations[*other].position - location.position).norm() < distance
            })
            .collect()
    };
    (0..locations.len()).map(around).collect()
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;

    /// Two rows of nine points 1 mm apart, each with an area of its own.
    fn uneven() -> Surface {
        let spec = SurfaceSpec::Rectangle { size: [0.008, 0.001], spacing: 0.001 };
        let mut surface = Surface::from_spec(&spec);
        surface.areas.iter_mut().enumerate().for_each(|(i, area)| *area = (i + 1) as f64 * 1e-6);
        surface
    }

    #[test]
    fn a_product_is_that_of_all_numbers() {
        for count in [0, 5, 16, 37] {
            let (a, b): (Vec<f32>, Vec<f32>) = (0..count).map(|i| (i as f32, (i % 7) as f32 - 2.0)).unzip();
            assert_eq!(dot(&a, &b), a.iter().zip(&b).map(|(a, b)| a * b).sum::<f32>());
        }
    }

    /// A press that leans is explained whole, and one that pulls not at all.
    #[test]
    fn a_place_explains_presses_that_lean() {
        let model = crate::testing::grid(1.0);
        let mut settings =
            Settings { unknowns: Unknowns::Full, search: Search::Near, ..Settings::new(0.004, 2.0) };
        let untouched = Untouched::of(&model).unwrap();
        let gains = [1.0; 25];
        let straight =
            Dictionary::new(&model, (None, None), 0.004, &Settings::new(0.004, 2.0), &gains).unwrap();
        let dictionary = Dictionary::new(&model, (None, None), 0.004, &settings, &gains).unwrap();
        settings.shear = Some(1e-4);
        let upright = Dictionary::new(&model, (None, None), 0.004, &settings, &gains).unwrap();
        let location = &dictionary.locations[37];
        let axes = tangents(&location.normal);
        let left = |lean: [f64; 2], newtons: f64| -> Vec<f32> {
            let force = (axes[0] * lean[0] + axes[1] * lean[1] - location.normal) * newtons;
            let contacts = vec![settings.indentation(location.position, force)];
            let mut out = vec![0.0; 25];
            model.response(&Stimulus { contacts, ..Stimulus::default() }, &mut out).unwrap();
            untouched.subtract(&mut out);
            out.iter().map(|v| *v as f32).collect()
        };
        let residuals = left([0.3, -0.2], 0.4);
        let whole = dot(&residuals, &residuals).sqrt();
        let of = |d: &Dictionary| d.explained(&residuals).nth(37).unwrap() / whole;
        assert!((of(&dictionary) - 1.0).abs() < 1e-5, "{}", of(&dictionary));
        assert!(of(&straight) < 0.99);
        // Nobody expects that much shear of this one.
        assert_eq!(of(&upright), of(&straight));
        let lean = dictionary.lean(37, &residuals);
        assert!((lean[0] - 0.3).abs() < 1e-4 && (lean[1] + 0.2).abs() < 1e-4, "{lean:?}");
        assert_eq!(straight.lean(37, &residuals), [0.0; 2]);
        let pulls: Vec<f32> = residuals.iter().map(|v| -v).collect();
        assert_eq!(dictionary.explained(&pulls).nth(37), Some(0.0));
    }

    /// A pattern that wanders off as it is pressed: light presses are those of the light pattern, where somebody keeps it.
    #[test]
    fn light_presses_are_compared_with_light_ones() {
        let at = |i: usize| (i as f64 - 9.5) * 2e-3;
        let elements = (0..400).map(|i| Point3::new(at(i % 20), at(i / 20), 0.0));
        let spec = SurfaceSpec::Rectangle { size: [0.034, 0.034], spacing: 0.002 };
        let model =
            dermis_fixtures::Analytic::new(Surface::from_spec(&spec), elements, 0.01, |c, element| {
                let off = element - c.position - Vector3::x() * (c.force.z * -0.02);
                -c.force.z * (-off.norm_squared() / 8e-6).exp()
            });
        let settings = Settings { search: Search::Near, ..Settings::new(0.004, 2.0) };
        let of = |settings: &Settings| {
            Dictionary::new(&model, (None, None), 0.004, settings, &vec![1.0; 400]).unwrap()
        };
        let (near, greedy) = (of(&settings), of(&Settings::new(0.004, 2.0)));
        // At the edge, from which the pattern of strong presses has left the elements.
        let edge = near.locations.iter().max_by(|a, b| a.position.x.total_cmp(&b.position.x)).unwrap();
        let contacts = vec![settings.indentation(edge.position, -edge.normal * 0.1)];
        let mut out = vec![0.0; 400];
        model.response(&Stimulus { contacts, ..Stimulus::default() }, &mut out).unwrap();
        let residuals: Vec<f32> = out.iter().map(|v| *v as f32).collect();
        let whole = dot(&residuals, &residuals).sqrt();
        let [light, strong] = [&near, &greedy].map(|dictionary| dictionary.clearest(&residuals) / whole);
        assert!(light > 0.999 && strong < 0.9, "{light} {strong}");
    }

    #[test]
    fn a_location_stands_for_the_area_of_the_points_that_it_keeps_out() {
        let surface = uneven();
        assert_eq!(surface.points.len(), 18);
        // Every point is a place.
        let all = thin(&surface, None, 0.0005);
        assert_eq!(all.iter().map(|p| p.area).collect::<Vec<_>>(), surface.areas);
        // On the line both rows fall together, and locations lie three points apart. The same without cells; no point is as near to
        // one place as to another.
        let locations = thin(&surface, Some(0.0), 0.0025);
        let mut expected: Vec<(f64, f64)> = Vec::new();
        for (point, area) in surface.points.iter().zip(&surface.areas) {
            let far = |location: &(f64, f64)| (location.0 - point.x).abs();
            match expected.iter_mut().min_by(|a, b| far(a).total_cmp(&far(b))) {
                Some(location) if far(location) < 0.0025 => location.1 += area,
                _ => expected.push((point.x, *area)),
            }
        }
        assert_eq!((locations.len(), expected.len()), (3, 3));
        for (location, (x, area)) in locations.iter().zip(&expected) {
            assert_eq!(location.position.x, *x);
            approx::assert_relative_eq!(location.area, *area, max_relative = 1e-12);
        }
    }
}
