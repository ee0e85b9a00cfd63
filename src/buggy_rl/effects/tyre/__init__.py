"""Another tyre friction, over a simulator whose tyre forces are not visible (a black box).

A step of the simulator shows velocities only. The effect reads the axle forces off them, scales
the friction of the tyre law that the simulator is known to have, and adds the difference of the
forces to the motion.

Symbols, with forces over the mass of the car [m/s^2] and index f, r for the axles:

| symbol | unit | meaning |
|---|---|---|
| v = (vx, vy), r | m/s, rad/s | velocity of the centre of gravity, yaw rate |
| ax, ay, dr/dt | m/s^2, rad/s^2 | force over mass and yaw acceleration, means of the step |
| a, b, L = a + b | m | centre of gravity to front and rear axle, wheelbase |
| I / m | m^2 | yaw inertia over mass |
| N_f, N_r | m/s^2 | axle load over mass; at rest g b / L and g a / L |
| F_f, F_r | m/s^2 | side force of an axle, along y of the body |
| X | m/s^2 | drive: longitudinal force of the driven treads |
| delta | rad | road-wheel angle of the front axle |
| D, C, c | -, 1/rad, - | friction, cornering stiffness over load, shape factor of an axle |
| s | - | normalised slip C alpha / (c D), alpha the slip angle |
| q | - | friction of the changed tyre over that of the simulated one |
| h | m | height of the longitudinal forces above the ground |
| R | m/s^2 | resistance at the body: r0 tanh(vx / 0.1 m/s) + r1 vx |
| dt | s | control period |

Tyre law (magic formula without curvature factor): F = N D sin(c atan(s)).

1. *Accelerations.* ax, ay, dr/dt from the velocities at both ends of the step.
2. *Loads.* N_f, N_r shifted by the pitch moment of the tyres: -+ h (ax + R) / L.
3. *Axle forces*, means of the step, from lateral force and yaw moment balance:
   F_f = (b ay + (I / m) dr/dt) / L,  F_r = (a ay - (I / m) dr/dt) / L.
   Of F_f the side component of a driven front axle's X is subtracted, and to the yaw moment the
   couple h F_f sin(delta) ay / g of the outer front wheel, which carries more and so brakes more,
   is added; both by two fixed-point iterations, because they depend on delta.
4. *Road-wheel angle* from the slip angle of the front axle that gives F_f by the law:
   delta = atan2(vy + a r, vx) + (c D / C) tan(asin(F_f / (D N_f cos(delta))) / c) sign(F_f).
5. *Drive.* X = ax + R + F_f tan(delta), not below 0, and 0 without a throttle command.
6. *Friction ellipse (combined slip).* Of a tread that slides u faster than the ground and w
   sideways the force is opposite to the slide: X = N D u / sqrt(u^2 + w^2), which gives u, and
   sqrt(1 - (X / (N D))^2) = w / sqrt(u^2 + w^2) is the share of N D left for the side force.
   With friction q D the wheels spin faster by z, a latent state: see `spin`. A simulator whose
   drive takes nothing from the side force (`combined_slip` 0) is scaled without this step.
7. *Forces at the start of the step.* At 2 m/s the slip angle of this car settles within about one
   period, so the mean force is not that of the initial slip. d(alpha)/dt = S (F - F_hold), with S
   the mobility of the axles and F_hold the force of a steady turn, gives for the mean
   F_mean = F_hold + (1 + M / 2)^-1 (F_start - F_hold),  M = dt S K, K = dF / d(alpha).
   It is inverted with the simulated slope K.
8. *Friction scaling by the similarity method*: slip s from F_start by the inverse law,
   s = tan(asin(F / (N D)) / c); the changed force is F' = q N D sin(c atan(s / q)). So the
   cornering stiffness stays, and the tyre slides at q N D.
9. *Back to the mean of the step* by step 7 with the changed slope, and with the loads changed by
   the changed longitudinal force (two iterations).
10. *Change of the motion*: dv and dr from F' - F of both axles, X' - X, the longitudinal component
    -(F_f' - F_f) tan(delta) of the front axle and the change of the couple of step 3.

Axles, centre of gravity and yaw inertia must be the simulator's own: read off with a quarter of the
inertia, the forces are so wrong that the effect does harm. `effects.measuring.geometry` fits them
to a simulator that does not say them.

Beyond the limit: a tyre that slides gives the same force at every slip angle, so the slip can no
longer be read off the force. From 98 % of N D on the law is faded out and F' is q F: right for a
tyre whose force stays constant past its peak; not readable are the slip itself, a force that falls
past the peak, and how far a changed tyre with q > 1 would be from its own peak. Also not modelled:
lateral load transfer between the wheels of an axle other than in the couple, camber, aligning
torque, relaxation length.

Sources: Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed., sec. 4.2 (similarity method), sec. 4.3
(magic formula), sec. 1.3 (lateral dynamics of the single-track car).
"""
