"""The recorded results of some sixty campaigns, and what computes and compares them."""
