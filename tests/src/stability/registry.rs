//! All cases, in the order of the list.

use super::bench::Bench;
use super::cases::{
    apertures, direct_light, environment, furnaces, fuzz, glossy, lens, limits, motion, numerics, scale,
    stills, traversal,
};

/// One entry of the list of cases.
#[derive(Clone, Copy)]
pub struct Case {
    /// Its name.
    pub id: &'static str,
    /// What is tried, in a few words.
    pub what: &'static str,
    /// Tries it.
    pub run: fn(&mut Bench),
}

const fn case(id: &'static str, what: &'static str, run: fn(&mut Bench)) -> Case {
    Case { id, what, run }
}

/// Every case.
pub const CASES: &[Case] = &[
    case("T1", "point light", direct_light::point_light),
    case("T2", "sun", direct_light::sun),
    case("T3", "parallel disk", direct_light::parallel_disk),
    case("T4", "parallel rectangle", direct_light::parallel_rectangle),
    case("T5", "perpendicular rectangle", direct_light::perpendicular_rectangle),
    case("T6", "sphere light", direct_light::sphere_light),
    case("T7", "tiny bright light", direct_light::tiny_and_bright),
    case("T8", "huge light", direct_light::huge),
    case("T9", "light edge-on", direct_light::edge_on),
    case("T10", "emitters without area", direct_light::without_area),
    case("T11", "back of an emitter", direct_light::back_side),
    case("T12", "light in a closed box", direct_light::closed_box),
    case("T13", "even sky", environment::even_sky),
    case("T14", "sky of one texel", environment::one_texel),
    case("T15", "black sky", environment::black_sky),
    case("T16", "broken texels", environment::broken_texels),
    case("T17", "knife edge", direct_light::knife_edge),
    case("T18", "closed furnace", furnaces::closed_globe),
    case("T19", "furnace of long paths", furnaces::long_paths),
    case("T20", "metal furnace", furnaces::metal_furnace),
    case("T21", "roughness sweep", furnaces::roughness_sweep),
    case("T22", "mirror", glossy::mirror),
    case("T23", "Fresnel", glossy::fresnel_terms),
    case("T24", "slab of index 1", glossy::invisible_slab),
    case("T25", "grazing view", furnaces::grazing),
    case("T26", "reciprocity and densities", glossy::reciprocity),
    case("T27", "multiple importance sampling", glossy::mis),
    case("T28", "power heuristic", glossy::heuristic),
    case("T29", "lens blur", lens::blur),
    case("T30", "closed aperture", lens::no_aperture),
    case("T31", "nearest focus", lens::nearest_focus),
    case("T32", "wide open lens", lens::wide_open),
    case("T33", "smallest aperture", lens::smallest_aperture),
    case("T34", "sweeping edge", motion::sweeping_edge),
    case("T35", "moving disk", motion::moving_disk),
    case("T36", "moving shadow", motion::moving_shadow),
    case("T37", "time inheritance", motion::time_inheritance),
    case("T38", "equal velocity", motion::equal_velocity),
    case("T39", "turning tip", motion::turning_tip),
    case("T40", "far traveller", motion::far_traveller),
    case("T41", "instant", motion::instant),
    case("T42", "halves of a shutter", motion::halves),
    case("T43", "watertight globe", traversal::watertight_globe),
    case("T44", "shared corners and edges", traversal::shared_corners),
    case("T45", "closed black box", scale::black_box),
    case("T46", "powers of two", scale::powers_of_two),
    case("T47", "far from the origin", scale::far_away),
    case("T48", "bases", traversal::bases),
    case("T49", "close plates", scale::close_plates),
    case("T50", "signed zeros", traversal::signed_zeros),
    case("T51", "nearly axial ray", traversal::nearly_axial),
    case("T52", "scaled instances", scale::scaled_instances),
    case("T53", "broken triangles", scale::broken_triangles),
    case("T54", "inseparable triangles", traversal::inseparable),
    case("T55", "grazing sun", scale::grazing_sun),
    case("T56", "coincident surfaces", traversal::coincident),
    case("T57", "sliver", traversal::sliver),
    case("T58", "long sums", numerics::long_sums),
    case("T59", "endless sequence", numerics::endless_sequence),
    case("T60", "far addresses", numerics::far_addresses),
    case("T61", "largest fraction", numerics::largest_fraction),
    case("T62", "bright pixels in files", numerics::bright_pixels),
    case("T63", "dim light", direct_light::dim),
    case("T64", "any division", numerics::any_division),
    case("M1", "turns against stills", stills::turns),
    case("M2", "scale through zero", stills::through_zero),
    case("M3", "morph against stills", stills::morph),
    case("M4", "skin against stills", stills::skin),
    case("M5", "moving camera against stills", stills::camera),
    case("M6", "nested motion against stills", stills::nested),
    case("M7", "shutter over a jump", stills::step),
    case("M8", "moving emitters against stills", stills::emitters),
    case("M9", "motion in mirror and glass", stills::seen_otherwise),
    case("M10", "shared mesh, own motions", stills::shared_mesh),
    case("L1", "aperture shapes", apertures::shapes),
    case("L2", "plane of focus", apertures::focal_plane),
    case("L3", "crowd of emitters", limits::crowd),
    case("L4", "odd lights", limits::odd_lights),
    case("L5", "emitter in a mirror", limits::mirrored_emitter),
    case("L6", "pixels far apart", limits::far_apart),
    case("L7", "pixel filters", limits::filters),
    case("L8", "limit on samples", limits::limited),
    case("F1", "random scenes", fuzz::random_scenes),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique() {
        let mut ids: Vec<_> = CASES.iter().map(|case| case.id).collect();
        ids.sort_unstable();
        assert!(ids.windows(2).all(|pair| pair[0] != pair[1]));
    }
}
