"""What a simulated campaign is made of: the rig, its step experiments, its noise, its faults.

Seconds, volts and mL/s throughout.  All records turn into plain JSON and back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from bayes_sensor.campaign import CampaignError


@dataclass(frozen=True)
class Step:
    """One step experiment: how it is set up and what really happens."""

    name: str
    carrier_flow: float
    """mL/s"""
    test_gas_flow: float
    """mL/s"""
    interval: float
    """s"""
    duration: float
    """s"""
    commanded_on: float
    commanded_off: float
    t0: float
    """s, when the gas really begins to switch on"""
    tf: float
    """s, when it begins to switch off"""
    y0: float
    """V"""
    beta: float
    """V, plateau above baseline"""

    @property
    def total_flow(self) -> float:
        """mL/s, as set."""
        return self.carrier_flow + self.test_gas_flow

    @property
    def concentration(self) -> float:
        """Test-gas fraction, as set."""
        return self.test_gas_flow / self.total_flow

    @property
    def n_samples(self) -> int:
        """How many samples are recorded."""
        return round(self.duration / self.interval)


@dataclass(frozen=True)
class Component:
    """One part of the noise: its share of the variance and its correlation.

    ``time`` 0 is white; otherwise the autocorrelation is ``exp(-lag/time) cos(2 pi frequency lag)``
    (an Ornstein-Uhlenbeck process, a damped oscillation where ``frequency`` is not 0, or with
    ``telegraph`` a process of two levels that has the same autocorrelation, with ``shot`` one-sided
    pulses that do, ``rate`` of them in a ``time``).  With ``smooth`` the part is white noise
    through a critically damped two-pole filter: ``exp(-lag/time) (1 + lag/time)``; with ``window``
    white noise averaged over the ``time`` past: ``max(0, 1 - lag/time)``.  With ``gusts`` it is an
    Ornstein-Uhlenbeck process whose variance jumps between 1 - ``depth`` and 1 + ``depth``, equally
    often and for exponentially distributed times whose correlation lasts ``gust_time``.  With
    ``sparks`` it is damped oscillations that start at random, ``rate`` of them in a ``time``; with
    ``echo`` an Ornstein-Uhlenbeck process and ``depth`` times itself 1/``frequency`` earlier; with
    ``difference`` (``time`` 0) white noise less ``depth`` times that of the sample before.  With
    ``turbulent`` the spectrum falls as f^-5/3 beyond the corner 1/(2 pi ``time``); with ``zeroed``
    it is a random walk that is set back to zero every ``time``; with ``pulsing`` an
    Ornstein-Uhlenbeck process that grows and shrinks by ``depth`` at ``frequency``.  With
    ``coupled`` an Ornstein-Uhlenbeck process has passed a high-pass filter with its corner at
    ``frequency``; with ``interpolated`` the part is straight lines between independent values a
    ``time`` apart; with ``fringes`` the interference of light that has passed ever more often, each
    time with ``depth`` of the amplitude, and whose phase loses its memory in a ``time``.  With
    ``diffusing`` it is a number of molecules that come and go by diffusion in a plane:
    ``1/(1 + lag/time)``; with ``speckle`` the squared modulus of a complex Ornstein-Uhlenbeck
    process; with ``whistling`` a tone that lasts a ``time`` in the mean and is then replaced by one
    whose frequency is anywhere within ``depth`` of ``frequency``, relatively.  With ``notched``
    white noise has lost what is within some 1/(2 pi ``time``) of ``frequency``; with
    ``interleaved`` (``time`` 0) white noise is by turns of variance 1 + ``depth`` and 1 -
    ``depth``; with ``charging`` it rises evenly and falls to the same level at random, every
    ``time`` in the mean.  With ``shaped`` (``time`` 0) it is the second difference of white noise;
    with ``motes`` light that specks take away while they cross a round beam, at the longest a
    ``time``, ``rate`` of them in a ``time``; with ``strokes`` a row of pulses at ``frequency``,
    each harmonic ``depth`` of the one before, whose phase loses its memory in a ``time``.  With
    ``bell`` its autocorrelation is ``exp(-(lag/time)^2)``; with ``bits`` an Ornstein-Uhlenbeck
    process is driven by steps of one size, up or down; with ``lognormal`` one is multiplied by the
    exponential of another one of rms ``depth`` that lasts a ``gust_time``.  With ``conducting`` it
    is the temperature at the end of a long bar: ``erfcx(sqrt(lag/time))``; with ``latching`` a
    process of two levels that goes to the other one at every second of the events that come at
    random, every ``time`` in the mean; with ``waning`` the variance of an Ornstein-Uhlenbeck
    process runs evenly between 1 + ``depth`` and 1 - ``depth`` in the course of a record.  With
    ``stops`` it is a random walk between two stops, whose slowest mode lasts a ``time``; with
    ``coded`` two levels, each ``time`` at random one half after the other or the other way round;
    with ``paces`` an Ornstein-Uhlenbeck process whose own time is ``time`` or ``depth`` times that,
    equally often and for times whose correlation lasts ``gust_time``.  With ``cut_off`` it is white
    below 1/(2 ``time``) and nothing beyond: ``sin(pi lag/time)/(pi lag/time)``; with ``settling``
    levels that are each held the longer, the longer they have been: ``(1 + lag/time)^-depth``; with
    ``drilled`` an Ornstein-Uhlenbeck process is louder for the share ``rate`` of a record, at one
    stretch, and of variance 1 - ``depth`` else.  With ``hunting`` it is a tone whose frequency
    swings about ``frequency`` by ``depth`` of it, once in a ``gust_time``, and whose phase loses
    its memory in a ``time``; with ``chattering`` the sign of an Ornstein-Uhlenbeck process:
    ``2/pi arcsin(exp(-lag/time))``; with ``replugged`` an Ornstein-Uhlenbeck process has another
    variance in each record, anywhere between 1 - ``depth`` and 1 + ``depth``.  With ``beating`` it
    is two tones as loud, at ``frequency`` times 1 - ``depth`` and 1 + ``depth``, whose phases lose
    their memory in a ``time``; with ``held`` independent levels that each stand for a ``time``;
    with ``trains`` one-sided pulses that die out in a ``time`` and come in trains, ``depth`` of
    them in the mean in the ``gust_time`` after a train's begin, of which there are ``rate`` in it.
    With ``sparkling`` (``time`` 0) a share ``rate`` of the samples is off by one and the same step,
    up or down; with ``binomial`` (``time`` 0) white noise is weighed 1, 2, 1; with ``dimmed`` it is
    a square wave of period ``time``, each of whose pulses is as long as chance will have it:
    anything from none to all of the period.  With ``overcorrected`` (``time`` 0) each sample takes
    back ``depth`` of the one before; with ``rectified`` it is the modulus of an Ornstein-Uhlenbeck
    process; with ``stretched`` its autocorrelation is ``exp(-(lag/time)^depth)``.  With ``teeth``
    it is levels that each stand for a ``time`` and come again every ``gust_time``, ``depth`` of
    them old; with ``diffused`` (``time`` 0) the spectrum goes as f^(1 - 2 ``depth``); with
    ``squared`` it is what a damped oscillation's square takes away.
    With ``flapping`` two levels of correlation ``exp(-lag/gust_time)`` have passed a lag of
    ``time``; with ``startled`` (``time`` 0) it is white, of a variance that is for the share
    ``depth`` the square of the sample before; with ``bubbles`` it is equal pulses that die out in a
    ``time``, ``rate`` of them in it, each of which waits for two events after the one before.
    With ``resting`` it is a random walk that drifts on to a stop and is thrown back there, its
    variance over its drift squared a ``time``; with ``balanced`` an Ornstein-Uhlenbeck process is
    multiplied by another one that lasts a ``gust_time``; with ``crests`` it is the highest of the
    crests that come at random, each of which sinks by Gumbel's unit in a ``time``.  With
    ``median`` (``time`` 0) each sample is the median of three of white noise, that and the two
    before; with ``phase`` the phase, between -pi and pi, of a complex Ornstein-Uhlenbeck process;
    with ``passing`` pulses s exp(-s^2/2) of either sign, s in units of ``time``, which come at
    random, ``rate`` of them in it.  With ``restarted`` each sample is the mean of white noise since
    one of the restarts that come at random, every ``time`` in the mean; with ``slowing`` the rate
    of an Ornstein-Uhlenbeck process goes evenly from 1/``time`` to 1/``depth`` times that, or back,
    in the course of a record; with ``referred`` (``time`` 0) white noise is divided by the rms of
    ``rate`` others.  With ``dry`` it is a speed under dry friction, its variance over the friction
    squared a ``time``; with ``larger`` the larger one of two Ornstein-Uhlenbeck processes; with
    ``repeated`` (``time`` 0) a share ``depth`` of white noise is the sample before once more.
    With ``clipped`` an Ornstein-Uhlenbeck process is cut off at ``depth`` of its rms, up and down;
    with ``thrice`` white noise has passed three equal lags: ``exp(-s) (1 + s + s^2/3)`` with s =
    lag/time; with ``fitful`` the clock of an Ornstein-Uhlenbeck process goes by leaps, a gamma
    process whose variance grows by ``gust_time`` in a second's mean progress.
    With ``fading`` it is the logarithm of the squared modulus of a complex Ornstein-Uhlenbeck
    process; with ``landscape`` the height where a random walk goes of one that never changes, an
    Ornstein-Uhlenbeck process of the place: ``erfcx(sqrt(lag/time))``; with ``fluttering`` the rate
    of an Ornstein-Uhlenbeck process is 1/``time`` and white noise, which makes ``depth`` of the
    variance.
    With ``counts`` (``time`` 0) it is how many come at random in a sample, ``rate`` in the mean;
    with ``retuned`` an Ornstein-Uhlenbeck process has another time in each record, between
    ``depth`` times ``time`` and that; with ``chaos`` (``time`` 0) each sample makes the next one:
    what is among the lower share ``depth`` is stretched, what is above that is turned over besides.
    """

    share: float
    time: float = 0.0
    """s"""
    frequency: float = 0.0
    """Hz"""
    shape: str = "gauss"
    """``gauss``, ``telegraph``, ``smooth``, ``shot``, ``window``, ``gusts``, ``sparks``, ``echo``,
    ``difference``, ``turbulent``, ``zeroed``, ``pulsing``, ``coupled``, ``interpolated``,
    ``fringes``, ``diffusing``, ``speckle``, ``whistling``, ``notched``, ``interleaved``,
    ``charging``, ``shaped``, ``motes``, ``strokes``, ``bell``, ``bits``, ``lognormal``,
    ``conducting``, ``latching``, ``waning``, ``stops``, ``coded``, ``paces``, ``cut_off``,
    ``settling``, ``drilled``, ``hunting``, ``chattering``, ``replugged``, ``beating``, ``held``,
    ``trains``, ``sparkling``, ``binomial``, ``dimmed``, ``overcorrected``, ``rectified``,
    ``stretched``, ``teeth``, ``diffused``, ``squared``, ``flapping``, ``startled``,
    ``bubbles``, ``resting``, ``balanced``, ``crests``, ``median``, ``phase``, ``passing``,
    ``restarted``, ``slowing``, ``referred``, ``dry``, ``larger``, ``repeated``,
    ``clipped``, ``thrice``, ``fitful``, ``fading``, ``landscape``, ``fluttering``,
    ``counts``, ``retuned`` or ``chaos``"""
    rate: float = 0.0
    depth: float = 0.0
    gust_time: float = 0.0
    """s"""


@dataclass(frozen=True)
class NoiseLaw:
    """Noise ``s_i z_i`` with z the sum of ``components`` and s^2 = sigma0^2 + sigma1^2 (c/c_max) x.

    x is the sensor's normalised response; the shares of the components add up to 1.
    """

    name: str
    sigma0: float
    """V"""
    sigma1: float = 0.0
    """V, extra at the highest concentration of the campaign"""
    components: tuple[Component, ...] = (Component(1.0),)

    @property
    def is_ar1(self) -> bool:
        """Whether one Ornstein-Uhlenbeck or white component makes all of it."""
        first = self.components[0]
        return len(self.components) == 1 and first.frequency == 0.0 and first.shape == "gauss"


@dataclass(frozen=True)
class Case:
    """A campaign to be simulated.

    ``strengths`` turns causes on by name (see ``CAUSES``); what is not named is off.  ``seed``
    decides everything random: noise, and the shapes that a cause draws for itself.
    """

    seed: int
    tau: float
    """s, sensor"""
    tau_v: float
    """s, valve"""
    V: float
    """mL, manifold"""
    steps: tuple[Step, ...]
    noise: NoiseLaw
    strengths: Mapping[str, float] = field(default_factory=dict)
    lsb: float = 0.0
    """V, step of the recorder; 0 records doubles"""
    title: str = "simulated rig"

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        object.__setattr__(self, "strengths", dict(self.strengths))
        if not self.steps or min(self.tau, self.tau_v, self.V) <= 0:
            raise CampaignError(
                "case: expected at least one experiment and positive tau, tau_v and V, got "
                f"{len(self.steps)} experiments, {self.tau} s, {self.tau_v} s, {self.V} mL"
            )

    @property
    def highest_concentration(self) -> float:
        """The highest test-gas fraction among the experiments."""
        return max(step.concentration for step in self.steps)

    def relative_concentration(self, step: Step) -> float:
        """The experiment's test-gas fraction over the campaign's highest."""
        return step.concentration / self.highest_concentration

    def to_json(self) -> dict[str, Any]:
        """Plain values.

        What a part of the noise may have and has not is left out, so that sealed files stay the
        same when kinds of noise are added.
        """
        content = asdict(self)
        for part in content["noise"]["components"]:
            for name in ("rate", "depth", "gust_time"):
                if part[name] == 0.0:
                    del part[name]
        return content

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Case:
        """The record that :meth:`to_json` wrote."""
        values = dict(content)
        law = dict(values["noise"])
        law["components"] = tuple(Component(**part) for part in law["components"])
        values["noise"] = NoiseLaw(**law)
        values["steps"] = tuple(Step(**step) for step in values["steps"])
        return cls(**values)
