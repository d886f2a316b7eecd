//! The allocator's state, for whoever looks at a replay.

use std::borrow::Cow;

use foveal_runtime::Content;

use super::Allocator;
use crate::insight::{Insight, MapRank, ObjectInsight};
use crate::message::saved::Told;

impl Allocator {
    /// What decides what it does next; objects by name, as what is thought of each.
    pub(super) fn told(&self) -> Content {
        let Insight {
            view: _,
            objects,
            maps,
            map_bytes,
            map_price_per_mib,
            textures,
            refinement,
            quality,
            lost_jobs,
        } = self.insight();
        let named = self.drawn.as_ref().map(|drawn| &drawn.world.scene.objects);
        let name = |id: usize| match named.and_then(|named| named.get(id)) {
            Some(object) => Cow::from(object.name.clone()),
            None => Cow::from(id.to_string()),
        };
        let [map_bytes_used, map_bytes_most] = map_bytes;
        let textures = textures.map(|(report, limit)| {
            Content::fields([
                ("used", Content::of(&report.used)),
                ("limit", Content::of(&limit)),
                ("held", Content::of(&report.held)),
                ("loaded_and_dropped", Content::of(&report.counts)),
                ("visible_error", Content::of(&report.visible_error())),
                ("price_per_mib", Content::of(&report.price_per_mib)),
            ])
        });
        let refinement = refinement.map(|progress| {
            Content::fields([
                ("tiles", Content::of(&progress.tiles)),
                ("quiet", Content::of(&progress.quiet)),
                ("error", Content::of(&progress.error)),
                ("stated", Content::of(&progress.stated)),
            ])
        });
        let none = || Content::Name("none".into());
        Content::fields([
            ("begun", Content::of(&self.begun)),
            ("drawn", self.drawn.content()),
            ("quality", Content::of(&quality)),
            ("in_flight", Content::of(&self.in_flight)),
            ("converged", Content::of(&self.told_converged)),
            ("refined", Content::of(&self.told_refined)),
            ("objects", Content::fields(objects.iter().enumerate().map(|(id, o)| (name(id), object(o))))),
            ("maps", Content::fields(maps.iter().map(|rank| (name(rank.object as usize), map(rank))))),
            ("map_bytes", Content::of(&map_bytes_used)),
            ("map_price_per_mib", Content::of(&map_price_per_mib)),
            (
                "budget",
                Content::fields([
                    ("maps", Content::of(&map_bytes_most)),
                    ("textures", textures.as_ref().and_then(|t| t.at("limit")).cloned().unwrap_or_else(none)),
                ]),
            ),
            ("textures", textures.unwrap_or_else(none)),
            ("refinement", refinement.unwrap_or_else(none)),
            ("lost_jobs", Content::of(&lost_jobs)),
            ("incidents", Content::of(&self.incidents)),
            ("outbox", Content::of(&self.outbox.len())),
        ])
    }
}

fn object(insight: &ObjectInsight) -> Content {
    let ObjectInsight { pixels, saliency, importance, attention, priority, level, error } = insight;
    Content::fields([
        ("pixels", Content::of(pixels)),
        ("saliency", Content::of(saliency)),
        ("importance", Content::of(importance)),
        ("attention", Content::of(attention)),
        ("priority", Content::of(priority)),
        ("level", Content::of(level)),
        ("error", Content::of(error)),
    ])
}

fn map(rank: &MapRank) -> Content {
    let MapRank { object: _, worth, side, wanted, kept } = rank;
    Content::fields([
        ("worth", Content::of(worth)),
        ("side", Content::of(side)),
        ("wanted", Content::of(wanted)),
        ("kept", Content::of(kept)),
    ])
}
