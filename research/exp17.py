import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
out=[]
for l in open("/tmp/e60/drawn.jsonl"):
    r=json.loads(l)
    if r["n"]<115: continue
    s=random_scan(r["seed"],None,CACHE); A,p=s.A,s.p
    sart(A[:5],p[:5],iterations=1,relaxation=1.0)
    t=time.perf_counter(); sart(A,p,iterations=3,relaxation=1.0,nonnegative=True); tp=(time.perf_counter()-t)/3
    t=time.perf_counter(); v=fast(A,p,photons=s.photons); tf=time.perf_counter()-t
    q=tf/tp/max(5,r["sart"][1]); out.append(q)
    print(r["seed"],s.family,"n",r["n"],"v",len(A),"passes",v.extras["passes"],"t %.1f SART passes, %.2f x; err %.2f"%(tf/tp,q,s.error(v.array)/r["sart"][0]),flush=True)
print(np.median(out),max(out))
