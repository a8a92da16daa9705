"""Undo and redo in the app, without a browser: what is remembered, and that each kind of edit is taken back."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from app.history import History
from app.motions import invented_motion
from app.session import Session
from runtime.finished_run import FinishedRun
from runtime.keyframes import Keyframe


@pytest.fixture
def session(smoke) -> Session:
    return Session(FinishedRun.open(smoke.results), "skirt", "walk", frames=24)


def test_edits_are_taken_back_and_made_again_in_their_order():
    history: History[int] = History()
    with pytest.raises(ValueError, match="nothing to undo"):
        history.undo(0)
    history.record("one", 0, frame=5)
    history.record("two", 1)
    assert (history.undoable, history.redoable) == ("two", None)
    step = history.undo(2)
    assert (step.name, step.frame, step.state) == ("two", None, 1)
    assert (history.undo(1).state, history.undoable, history.redoable) == (0, None, "one")
    again = history.redo(0)
    assert (again.frame, again.state) == (5, 1) and history.redo(1).state == 2
    with pytest.raises(ValueError, match="nothing to redo"):
        history.redo(2)
    history.undo(2)
    history.record("three", 1)
    assert history.redoable is None and history.undoable == "three"


def test_a_slider_that_is_held_makes_one_edit():
    time = [0.0]
    history: History[int] = History(pause=1.0, now=lambda: time[0])

    def slide(state: int, after: float, what: str = "bend") -> None:
        time[0] += after
        history.record(what, state, held=what)

    for state, after in enumerate((0.0, 0.5, 0.9, 1.5)):  # the pause before the last makes it another
        slide(state, after)
    assert [history.undo(9).state for _ in range(2)] == [3, 0] and history.undoable is None
    slide(0, 0.1)
    slide(1, 0.1, "shear")
    slide(2, 0.1, "shear")
    assert history.undo(3).state == 1
    slide(1, 0.1, "shear")  # after an undo it is another edit
    assert [history.undo(2).state, history.undo(1).state] == [1, 0]


def test_no_more_than_asked_for_is_remembered():
    history: History[int] = History(most=3)
    for state in range(10):
        history.record(str(state), state)
    assert [history.undo(10).state for _ in range(3)] == [9, 8, 7] and history.undoable is None


def _mesh(session: Session, folder) -> None:
    path = folder / "mine.obj"
    shown = session.look_of(20, session.candidates(range(3, 4)))[0].garment
    trimesh.Trimesh(shown + np.float32([0.0, 0.0, 0.02]), session.faces, process=False).export(path)
    session.insert_mesh(20, path)


EDITS = {
    "keyframe at frame 4": lambda s, _: s.insert(4),
    "density at frame 4": lambda s, _: s.insert_parameters(4, {"density": s.ranges["density"][1]}),
    "candidate 9 at frame 12": lambda s, _: s.insert_latent(12, s.candidates(range(9, 10))[0], "candidate 9"),
    "bend damping at frame 12": lambda s, _: s.insert_parameters(12, {"bend_damping": s.ranges["bend_damping"][0]}),
    "mine.obj at frame 20": _mesh,
    "keyframe 12 moved to 15": lambda s, _: s.move(12, 15),
    "refinement off": lambda s, _: s.set_refine(False),
    "feet planted": lambda s, _: s.plant_feet(),
    "body shape": lambda s, _: s.use_shape([1.0, -0.5, 0.0, 0.0, 0.5]),
    "motion squat_0001": lambda s, _: s.use_clip(invented_motion(s.run, "squat", 31, 1)),
    "keyframe 5 deleted": lambda s, _: s.delete(5),
    "garment tshirt": lambda s, _: s.use_garment("tshirt"),
}


def _seen(session: Session) -> list[np.ndarray]:
    looks = [session.look(frame) for frame in (4, 13, 20)]
    return [part for look in looks for part in (look.garment, look.body)]


def test_every_edit_is_undone_and_redone(session, tmp_path):
    states = [(_seen(session), session.keyframes, session.refine)]
    for name, edit in EDITS.items():
        edit(session, tmp_path)
        assert session.undoable == name and session.redoable is None
        states.append((_seen(session), session.keyframes, session.refine))

    def as_in(number: int) -> None:
        seen, keys, refine = states[number]
        for now, then in zip(_seen(session), seen, strict=True):
            np.testing.assert_allclose(now, then, atol=1e-5)
        assert [(k.frame, k.origin) for k in session.keyframes] == [(k.frame, k.origin) for k in keys]
        assert session.refine == refine

    for number, name in reversed(list(enumerate(EDITS))):
        assert session.undo().name == name
        as_in(number)
        # What the sliders show comes back, too.
        assert set(session.parameters_at(4)) == set(session.ranges)
    assert session.undoable is None
    for number, name in enumerate(EDITS):
        assert session.redo().name == name
        as_in(number + 1)
    assert session.redoable is None


def test_an_undone_material_is_again_the_one_that_the_sliders_show(session):
    session.insert(3)
    before = session.parameters_at(3)
    session.insert_parameters(3, {"density": session.ranges["density"][1]})
    step = session.undo()
    assert step.frame == 3 and session.parameters_at(3) == before and session.keyframe(3).origin == "material"


def test_an_undo_stops_what_is_being_made_and_it_is_made_again(session):
    session.insert_parameters(0, {"density": session.ranges["density"][1]})

    def undo(share: float) -> None:
        if session.undoable:
            session.undo()

    assert not session.remake(progress=undo)
    assert session.made < 1.0 and session.remake() and session.made == 1.0


def test_what_failed_or_changed_nothing_is_no_edit(session, tmp_path):
    session.insert(3)
    name = session.undoable
    (tmp_path / "bad.obj").write_text("v 1 2 three\n")
    for wrong in (
        lambda: session.insert_parameters(3, {"density": 1e3}),
        lambda: session.insert_mesh(3, tmp_path / "bad.obj"),
        lambda: session.delete(7),
        lambda: session.move(7, 9),
        lambda: session.insert(99),
        lambda: session.use_garment("hat"),
        lambda: session.use_shape([9.0, 0.0, 0.0, 0.0, 0.0]),
    ):
        with pytest.raises(ValueError):
            wrong()
    session.insert(3)
    session.move(3, 3)
    session.set_refine(True)
    assert session.undoable == name
    session.undo()
    assert session.keyframes == () and session.undoable is None
    with pytest.raises(ValueError, match="nothing to undo"):
        session.undo()
    assert session.redoable == name  # a failed undo loses nothing


def test_keyframes_that_do_not_fit_leave_those_that_there_are(session):
    session.insert(3)
    composer = session._keys.composer
    with pytest.raises(ValueError, match="has the frames 0 to 23"):
        composer.use([Keyframe(2, composer.keyframes[0].latent), Keyframe(24, composer.keyframes[0].latent)])
    assert [key.frame for key in composer.keyframes] == [3]
