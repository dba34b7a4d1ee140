from __future__ import annotations

import pytest

from synchronizar.live.messages import LARGEST_DATA, Create, MessageError, Move, Object, Quaternion, Vector
from synchronizar.live.objects import LEASE_S, MOST_OBJECTS, ObjectStore

NO_TURN = (0.0, 0.0, 0.0, 1.0)


def nowhere(user: str, position: Vector, quat: Quaternion) -> None:
    """Nobody is registered."""


def moved(_: str, position: Vector, quat: Quaternion) -> tuple[Vector, Quaternion]:
    """Everybody's frame lies 10 m to the east of the common one."""
    x, y, z = position
    return (x + 10.0, y, z), quat


def store_with_ball(hold: bool = False) -> ObjectStore:
    store = ObjectStore()
    store.create(Create("ball", "sphere", (1.0, 2.0, 3.0), hold=hold), "alice", 0.0, nowhere)
    store.changes()
    return store


def test_an_object_stands_where_it_was_put_and_its_creator_is_known() -> None:
    ball = store_with_ball().objects["ball"]
    assert (ball.position, ball.by, ball.holder) == ((1.0, 2.0, 3.0), "alice", None)


def test_two_cannot_hold_one_object() -> None:
    store = store_with_ball()
    store.grab("ball", "bob", 1.0)
    with pytest.raises(MessageError, match="bob holds 'ball'"):
        store.grab("ball", "carol", 1.0)
    with pytest.raises(MessageError, match="carol does not hold"):
        store.move(Move("ball", (0.0, 0.0, 0.0)), "carol", 1.0)
    with pytest.raises(MessageError, match="bob holds"):
        store.remove("ball", "carol")
    store.release("ball", "bob")
    store.grab("ball", "carol", 1.5)
    assert store.objects["ball"].holder == "carol"


def test_who_falls_silent_holds_nothing_after_its_lease_and_who_speaks_keeps_it() -> None:
    store = store_with_ball(hold=True)
    store.alive("alice", 4.0)
    store.expire(4.0 + LEASE_S)
    assert store.objects["ball"].holder == "alice"
    store.expire(4.0 + LEASE_S + 0.1)
    assert store.objects["ball"].holder is None
    store.expire(100.0)


def test_what_waits_for_its_device_is_told_to_nobody_and_then_stands_in_the_common_frame() -> None:
    store = ObjectStore()
    store.create(Create("coin", "coin", (1.0, 0.0, 0.0), user="bob"), "bob", 0.0, nowhere)
    assert store.changes() is None
    assert store.snapshot().changed == []
    store.place_waiting(nowhere, 1.0)
    assert store.changes() is None
    store.place_waiting(moved, 2.0)
    changes = store.changes()
    assert changes is not None
    assert [(o.position, o.waits_for) for o in changes.changed] == [((11.0, 0.0, 0.0), None)]


def test_of_many_moves_the_last_is_told_and_versions_rise() -> None:
    store = store_with_ball(hold=True)
    before = store.version
    for x in range(5):
        store.move(Move("ball", (float(x), 0.0, 0.0), velocity=(1.0, 0.0, 0.0)), "alice", 1.0)
    changes = store.changes()
    assert changes is not None
    assert [o.position for o in changes.changed] == [(4.0, 0.0, 0.0)]
    assert changes.version == before + 5
    assert store.changes() is None


def test_what_is_removed_is_told_once() -> None:
    store = store_with_ball()
    store.remove("ball", "bob")
    changes = store.changes()
    assert changes is not None
    assert (changes.changed, changes.removed) == ([], ["ball"])
    with pytest.raises(MessageError, match="no object"):
        store.grab("ball", "bob", 0.0)


def test_what_is_removed_and_there_again_at_once_is_told_as_it_now_stands() -> None:
    store = store_with_ball()
    store.remove("ball", "alice")
    store.create(Create("ball", "sphere", (4.0, 5.0, 6.0)), "alice", 1.0, nowhere)
    told = store.changes()
    assert told is not None
    assert (told.changed, told.removed) == ([store.objects["ball"]], [])
    store.remove("ball", "alice")
    store.create(Create("ball", "sphere", (4.0, 5.0, 6.0), user="bob"), "alice", 2.0, nowhere)
    told = store.changes()
    assert told is not None
    assert (told.changed, told.removed) == ([], ["ball"])


@pytest.mark.parametrize(
    ("create", "fault"),
    [
        (Create("ball", "sphere", (0.0, 0.0, 0.0)), "already"),
        (Create("", "sphere", (0.0, 0.0, 0.0)), "id"),
        (Create("new", "sphere", (1e9, 0.0, 0.0)), "place"),
        (Create("new", "sphere", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)), "quaternion"),
        (Create("new", "sphere", (0.0, 0.0, 0.0), data="x" * LARGEST_DATA), "data"),
    ],
)
def test_an_object_that_makes_no_sense_is_refused(create: Create, fault: str) -> None:
    with pytest.raises(MessageError, match=fault):
        store_with_ball().create(create, "bob", 0.0, nowhere)


def test_a_room_takes_so_many_objects_and_no_more() -> None:
    store = ObjectStore()
    for n in range(MOST_OBJECTS):
        store.create(Create(str(n), "coin", (0.0, 0.0, 0.0)), "bob", 0.0, nowhere)
    with pytest.raises(MessageError, match="remove some"):
        store.create(Create("more", "coin", (0.0, 0.0, 0.0)), "bob", 0.0, nowhere)


def test_every_change_is_handed_to_who_keeps_them_and_restored_objects_are_free() -> None:
    kept: dict[str, Object] = {}

    def save(changed: Object | str) -> None:
        if isinstance(changed, str):
            del kept[changed]
        else:
            kept[changed.id] = changed

    store = ObjectStore(save)
    store.create(Create("a", "coin", (0.0, 0.0, 0.0), hold=True), "bob", 0.0, nowhere)
    store.create(Create("b", "coin", (0.0, 0.0, 0.0)), "bob", 0.0, nowhere)
    store.remove("b", "bob")
    again = ObjectStore()
    again.restore(list(kept.values()))
    assert list(again.objects) == ["a"]
    assert again.objects["a"].holder is None
    again.grab("a", "carol", 0.0)
