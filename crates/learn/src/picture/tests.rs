use dermis_skin::SurfaceSpec;

use super::*;
use crate::dataset::tests::contact;

fn panel() -> Surface {
    Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.54, 0.56], spacing: 0.01 })
}

fn truth(contacts: &[(f64, f64, f64)]) -> Truth {
    let contacts: Vec<_> = contacts.iter().map(|(x, y, f)| contact(*x, *y, *f)).collect();
    Truth { press: 0, location: 0, idle: contacts.is_empty(), contacts }
}

/// Pixel and diameter \[mm\] of the twelve maps of the thesis' Table 4.5, whose pictures are of 640 mm.
const MAPS: [(usize, usize); 12] = [
    (4, 20),
    (4, 28),
    (4, 32),
    (4, 44),
    (4, 52),
    (4, 60),
    (10, 10),
    (10, 30),
    (10, 50),
    (10, 70),
    (20, 20),
    (20, 60),
];

fn map((pixel, diameter): (usize, usize)) -> Picture {
    let millimetres = |v: usize| v as f64 * 1e-3;
    Picture { pixels: [640 / pixel; 2], pixel: millimetres(pixel), diameter: millimetres(diameter) }
}

#[test]
fn a_picture_keeps_forces_and_their_centre() {
    for of in MAPS {
        let picture = map(of);
        let pictures = Pictures::new(picture, &panel()).unwrap();
        let mut image = Vec::new();
        pictures.append(&truth(&[(0.101, -0.053, 30.0), (-0.2, 0.2, 5.0)]), &mut image);
        assert_eq!(image.len(), picture.len());
        approx::assert_relative_eq!(image.iter().sum::<f64>(), 35.0, max_relative = 1e-12);
        let columns = picture.pixels[1];
        let at = |i: usize| ((i % columns) as f64 - (columns as f64 - 1.0) / 2.0) * picture.pixel;
        let moment: f64 = image.iter().enumerate().map(|(i, f)| at(i) * f).sum();
        // A disc is known to an eighth of a pixel, its middle much better.
        let error = (moment - (0.101 * 30.0 - 0.2 * 5.0)).abs() / 35.0;
        assert!(error < picture.pixel / 8.0, "{of:?}: {error} m");
    }
}

#[test]
fn a_disc_has_the_requested_width() {
    let pictures = Pictures::new(map((4, 60)), &panel()).unwrap();
    let mut image = Vec::new();
    pictures.append(&truth(&[(0.0, 0.0, 9.0)]), &mut image);
    let full = image.iter().copied().fold(0.0, f64::max);
    // π (30 mm)² of pixels of 16 mm².
    let pixels = std::f64::consts::PI * 900.0 / 16.0;
    assert!((9.0 / full / pixels - 1.0).abs() < 0.01, "{full}");
    image.clear();
    pictures.append(&truth(&[(1.0, 0.0, 9.0)]), &mut image);
    assert!(image.iter().all(|f| *f == 0.0), "it lies outside of the picture");
    let mut unknown = truth(&[(0.0, 0.0, 9.0)]);
    unknown.contacts[0].components = dermis_skin::ForceComponents::None;
    image.clear();
    pictures.append(&unknown, &mut image);
    assert!(image.iter().all(|f| f.is_nan()));
}

#[test]
fn on_the_surface_forces_and_locations_stay() {
    let surface = panel();
    for of in MAPS {
        let picture = map(of);
        let mixing = Mixing::new(&picture, &surface).unwrap();
        assert_eq!((mixing.rows(), mixing.columns()), (surface.points.len(), picture.len()));
        let pictures = Pictures::new(picture, &surface).unwrap();
        let mut image = Vec::new();
        pictures.append(&truth(&[(0.1, -0.05, 30.0)]), &mut image);
        let map = mixing.apply(&image);
        approx::assert_relative_eq!(map.iter().sum::<f64>(), 30.0, max_relative = 1e-9);
        for axis in 0..2 {
            let moment: f64 = surface.points.iter().zip(&map).map(|(p, f)| p[axis] * f).sum();
            let error = (moment / 30.0 - [0.1, -0.05][axis]).abs();
            assert!(error < picture.pixel / 8.0, "{of:?}: {error} m along axis {axis}");
        }
        // An even picture is an even pressure: no point inside of the rim is forgotten.
        let even = mixing.apply(&vec![1.0; picture.len()]);
        for (force, (area, p)) in even.iter().zip(surface.areas.iter().zip(&surface.points)) {
            if p.x.abs() < 0.24 && p.y.abs() < 0.25 {
                let pressure = force / area * picture.pixel.powi(2);
                // Pixels as wide as the points are apart beat with them: a third more, or less.
                let even = if picture.pixel < 0.02 { 0.2 } else { 0.4 };
                assert!((pressure - 1.0).abs() < even, "{of:?}: {pressure} at {p}");
            }
        }
    }
}

#[test]
fn a_contact_at_the_rim_keeps_its_force() {
    let surface = panel();
    for of in MAPS {
        let picture = map(of);
        let (pictures, mixing) =
            (Pictures::new(picture, &surface).unwrap(), Mixing::new(&picture, &surface).unwrap());
        for place in [(0.258, 0.0), (-0.258, 0.268), (0.0, -0.27)] {
            let mut image = Vec::new();
            pictures.append(&truth(&[(place.0, place.1, 12.0)]), &mut image);
            approx::assert_relative_eq!(image.iter().sum::<f64>(), 12.0, max_relative = 1e-12);
            approx::assert_relative_eq!(mixing.apply(&image).iter().sum::<f64>(), 12.0, max_relative = 1e-9);
        }
    }
}

#[test]
fn what_has_no_picture_is_refused() {
    let dome = Surface::from_spec(&SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 });
    let refused =
        |picture: Picture, surface: &Surface| Mixing::new(&picture, surface).unwrap_err().to_string();
    insta::assert_snapshot!(refused(map((4, 20)), &dome), @"training: `network.image` draws forces as seen along z of the skin's link, and this surface bends away from that: give the link a z axis out of the skin, or leave `network.image` out");
    let wrong = |change: &dyn Fn(&mut Picture)| {
        let mut picture = map((4, 20));
        change(&mut picture);
        let (field, reason) = picture.check().unwrap_err();
        format!("{field} {reason}")
    };
    insta::assert_snapshot!(wrong(&|p| p.pixels = [0, 3]), @"pixels is [0, 3] and must be rows and columns from 1 to 4096");
    insta::assert_snapshot!(wrong(&|p| p.diameter = f64::NAN), @"diameter is NaN m and must be a positive length");
}
