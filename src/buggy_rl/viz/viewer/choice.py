"""Where a film is played: in MuJoCo's viewer or in the browser."""

from buggy_rl.extras import needs
from buggy_rl.viz.film.director import Director
from buggy_rl.viz.film.options import Live


def play(director: Director, playback: float = 1.0, where: Live = True) -> None:
    """Plays until it is ended.

    Args:
        director: Of one or two tracks.
        playback: Seconds of driving in a second.
        where: `window`, `browser`, or True for the window where there is a screen.

    Raises:
        ValueError: There is no screen for a window.
    """
    if shown_in(where) == "window":
        from buggy_rl.viz.film import live

        return live.play(director, playback)
    needs("viser", "visual", "a film in the browser")
    from buggy_rl.viz.viewer import film_player

    film_player.play(director, playback)


def shown_in(where: Live) -> str:
    """`window` or `browser`."""
    from buggy_rl.viz.film.live import has_screen

    if where is True:
        return "window" if has_screen() else "browser"
    return str(where)
