//! Which of the lights at a place is sampled: nothing to do for one, all compared for a few, a tree for many.

use super::{
    bounds::{Item, LightBounds, unite},
    geometry::View,
    tree::LightTree,
};

/// Up to as many lights are compared one by one, which is exact where a tree's bounds are coarse, and no slower.
const FEW: usize = 8;

/// Chooses among lights that are numbered 0, 1, 2, ...
#[derive(Debug)]
pub(super) enum Chooser {
    None,
    One(LightBounds),
    Few(Vec<LightBounds>),
    Tree(LightTree),
}

impl Chooser {
    /// Over all lights; `unit` divides their powers.
    pub fn build(mut items: Vec<Item>, unit: f64) -> Self {
        items.sort_unstable_by_key(|item| item.emitter);
        let mut bounds = items.iter().map(|item| unite(core::slice::from_ref(item), unit));
        match items.len() {
            0 => Self::None,
            1 => bounds.next().map_or(Self::None, Self::One),
            2..=FEW => Self::Few(bounds.collect()),
            _ => Self::Tree(LightTree::build(items, unit)),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        matches!(self, Self::None)
    }

    /// Nodes of the tree, if there is one.
    pub fn nodes(&self) -> usize {
        if let Self::Tree(tree) = self { tree.nodes() } else { 0 }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        match self {
            Self::None | Self::One(_) => 0,
            Self::Few(lights) => size_of_val(lights.as_slice()),
            Self::Tree(tree) => tree.bytes(),
        }
    }

    /// Estimated irradiance from all lights, in units of `unit`; zero only where none can arrive.
    pub fn importance(&self, view: &View) -> f64 {
        match self {
            Self::None => 0.0,
            Self::One(light) => light.importance(view),
            Self::Few(lights) => importances(lights, view).iter().sum(),
            Self::Tree(tree) => tree.importance(view),
        }
    }

    /// A light and the probability of choosing it; none where no light can arrive.
    pub fn sample(&self, view: &View, u: f64) -> Option<(u32, f64)> {
        match self {
            Self::None => None,
            Self::One(_) => Some((0, 1.0)),
            Self::Few(lights) => {
                let importances = importances(lights, view);
                let total: f64 = importances.iter().sum();
                let mut rest = u * total;
                let mut chosen = None;
                for (light, &importance) in importances.iter().enumerate() {
                    if importance > 0.0 {
                        chosen = Some((light as u32, importance / total));
                        if rest < importance {
                            break;
                        }
                        rest -= importance;
                    }
                }
                chosen
            }
            Self::Tree(tree) => tree.sample(view, u),
        }
    }

    /// The probability with which [`Chooser::sample`] chooses a light.
    pub fn probability(&self, view: &View, emitter: u32) -> f64 {
        match self {
            Self::None => 0.0,
            Self::One(_) => 1.0,
            Self::Few(lights) => {
                let importances = importances(lights, view);
                let total: f64 = importances.iter().sum();
                if total > 0.0 { importances[emitter as usize] / total } else { 0.0 }
            }
            Self::Tree(tree) => tree.probability(view, emitter),
        }
    }
}

fn importances(lights: &[LightBounds], view: &View) -> [f64; FEW] {
    let mut importances = [0.0; FEW];
    for (importance, light) in importances.iter_mut().zip(lights) {
        *importance = light.importance(view);
    }
    importances
}
