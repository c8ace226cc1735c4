use dermis_skin::SurfaceSpec;

use super::*;

#[test]
fn the_edge_of_a_skin_follows_the_area_of_its_points() {
    for pitch in [0.0005, 0.002, 0.004] {
        let spec = SurfaceSpec::Rectangle { size: [20.0 * pitch, 10.0 * pitch], spacing: pitch };
        let surface = Surface::from_spec(&spec);
        // 21 × 11 points on the area of 20 × 10 squares.
        let spacing = candidates::point_spacing(&surface);
        assert!((spacing / pitch - (200.0f64 / 231.0).sqrt()).abs() < 1e-9, "{spacing}");
        let rule = Feasibility { neighbours: 9, edge: EDGE * spacing, ..Feasibility::default() };
        for (point, verdict) in surface.points.iter().zip(feasible(&surface, &surface.points, &rule)) {
            let rim = point.x.abs() > 9.9 * pitch || point.y.abs() > 4.9 * pitch;
            assert_eq!(verdict, if rim { Verdict::Edge } else { Verdict::Feasible }, "{point}");
        }
    }
}
