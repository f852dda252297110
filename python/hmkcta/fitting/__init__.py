"""The paper's algorithms: one level on one node (`fit`), its subdivision, and the levels of a hierarchy.

From the bottom up: HOSVD (`tucker`), disjoint starts (`memberships`), contraction (`projection`), a sweep (`search`),
MK-CTA of one node (`fit`), most and least significant clusters (`subdivision`), HMK-CTA (`hierarchy`). Of a tensor that
memory does not hold a level is fitted by `workset`, or by `disjoint` where no two of its blocks share an element.
"""
