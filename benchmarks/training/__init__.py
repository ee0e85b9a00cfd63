"""Parts of ppo.py: what is trained, how it is timed, what it scores, where its time goes."""
